"""Reading SMPL's old pickles without running anything they ask for."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.body.files.pickle_machine import Machine, StandIn
from solver_backend.body.files.pickled_arrays import finished
from solver_backend.exchange.errors import BodyInvalid, UnsafePickle
from solver_backend.exchange.regular_file import open_regular

MAX_ELEMENTS = 50_000_000
"""Of a matrix that is stored sparse: the joint regressor of the largest family has 0.6 million."""
_CHUMPY = frozenset({"chumpy.ch.Ch", "chumpy.reordering.Select"})
_SPARSE = frozenset({"scipy.sparse.csc.csc_matrix", "scipy.sparse._csc.csc_matrix"})
_DAMAGE = (OSError, EOFError, ValueError, TypeError, KeyError, IndexError, OverflowError, RecursionError, MemoryError)


def read_pickle(path: Path) -> dict[str, Any]:
    """Return the arrays, texts and numbers of a pickled body model; other values are left out.

    Raises:
        UnsafePickle: the file asks for a class or function other than array constructors.
        BodyInvalid: the file is damaged or is no dictionary.
    """
    try:
        with open_regular(path) as stream:
            content = Machine(stream, str(path), _CHUMPY | _SPARSE).load()
        if isinstance(content, dict):
            values = {str(key): _plain(value) for key, value in content.items()}
            return {key: value for key, value in values.items() if not isinstance(value, list | tuple | dict)}
    except (UnsafePickle, BodyInvalid):
        raise
    except _DAMAGE as error:
        raise BodyInvalid(
            f"The pickle cannot be read: {error}", where=str(path), hint="The file may be truncated."
        ) from error
    raise BodyInvalid(f"The pickle holds a {type(content).__name__}; a dictionary is expected.", where=str(path))


def _plain(value: Any) -> Any:
    """Return stand-ins as arrays and anything else as it is."""
    if isinstance(value, StandIn):
        return _chumpy(value.state) if value.kind in _CHUMPY else _sparse_columns(value.state)
    return finished(value)


def _chumpy(state: dict[str, Any]) -> np.ndarray:
    """Return a chumpy array: ``x``, or the elements ``idxs`` of ``a``."""
    if "x" in state:
        return _member(state, "x")
    if "a" in state and "idxs" in state:
        chosen = _member(state, "a").reshape(-1)[_member(state, "idxs")]
        shape = finished(state.get("preferred_shape"))
        return chosen if shape is None else chosen.reshape(tuple(int(size) for size in shape))
    raise BodyInvalid(
        f"A chumpy array holds {', '.join(sorted(map(str, state))) or 'nothing'}; 'x' or 'a' and 'idxs' are expected.",
        hint="Convert the file to .npz with the vendor's own tool.",
    )


def _sparse_columns(state: dict[str, Any]) -> np.ndarray:
    """Return SciPy's compressed sparse column matrix, dense."""
    rows, columns = (int(size) for size in state.get("_shape") or state["shape"])
    data, indices, pointers = (_member(state, name) for name in ("data", "indices", "indptr"))
    sound = (
        0 <= rows * columns <= MAX_ELEMENTS
        and rows >= 0
        and pointers.shape == (columns + 1,)
        and data.ndim == indices.ndim == 1
        and len(data) == len(indices) == pointers[-1]
        and pointers[0] == 0
        and bool((np.diff(pointers.astype(np.int64)) >= 0).all())
        and bool(((indices >= 0) & (indices < rows)).all())
    )
    if not sound:
        raise BodyInvalid(
            f"A sparse matrix of {rows} x {columns} has parts that do not fit together.",
            hint="The file may be truncated; download the model again.",
        )
    dense = np.zeros((rows, columns))
    dense[indices, np.repeat(np.arange(columns), np.diff(pointers.astype(np.int64)))] = data
    return dense


def _member(state: dict[str, Any], name: str) -> np.ndarray:
    """Return a stand-in's array; a list is refused, as nested ones can grow without bound."""
    value = _plain(state[name])
    if not isinstance(value, np.ndarray):
        raise ValueError(f"{name} is a {type(value).__name__}; an array is expected")
    return value
