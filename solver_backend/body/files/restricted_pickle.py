"""Reading SMPL's old pickles without running anything they ask for."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from solver_backend.exchange.errors import BodyInvalid, UnsafePickle

_DAMAGE = (
    OSError, EOFError, ValueError, TypeError, KeyError, IndexError, AttributeError, pickle.UnpicklingError,
)  # fmt: skip
"""What a damaged pickle raises."""


class _Chumpy:
    """Stands in for chumpy's arrays: holds the state, never computes."""

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.state = state

    def array(self) -> np.ndarray:
        """Return ``x``, or the elements ``idxs`` of ``a``."""
        if "x" in self.state:
            return np.asarray(plain(self.state["x"]))
        if "a" in self.state and "idxs" in self.state:
            chosen = np.asarray(plain(self.state["a"])).reshape(-1)[np.asarray(self.state["idxs"])]
            shape = self.state.get("preferred_shape")
            return chosen.reshape(shape) if shape is not None else chosen
        raise BodyInvalid(
            f"A chumpy array holds {', '.join(sorted(self.state))}; 'x' or 'a' and 'idxs' are expected.",
            hint="Convert the file to .npz with the vendor's own tool.",
        )


class _SparseColumns:
    """Stands in for SciPy's compressed sparse column matrix."""

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.state = state

    def array(self) -> np.ndarray:
        """Return the dense matrix."""
        rows, columns = self.state.get("_shape") or self.state["shape"]
        dense = np.zeros((rows, columns))
        pointers = np.asarray(self.state["indptr"])
        column = np.repeat(np.arange(columns), np.diff(pointers))
        dense[np.asarray(self.state["indices"]), column] = np.asarray(self.state["data"])
        return dense


def _encode_latin1(text: str, encoding: str = "latin1") -> bytes:
    """Return the bytes that Python 2 pickled as text."""
    if encoding != "latin1":
        raise UnsafePickle(f"The pickle asks for the text encoding {encoding!r}; only latin1 occurs in body files.")
    return text.encode("latin1")


_ALLOWED: dict[tuple[str, str], Any] = {
    ("numpy", "ndarray"): np.ndarray,
    ("numpy", "dtype"): np.dtype,
    ("_codecs", "encode"): _encode_latin1,
    ("chumpy.ch", "Ch"): _Chumpy,
    ("chumpy.reordering", "Select"): _Chumpy,
    ("scipy.sparse.csc", "csc_matrix"): _SparseColumns,
    ("scipy.sparse._csc", "csc_matrix"): _SparseColumns,
}
# NumPy's own constructors, asked of NumPy itself: their module moved between NumPy 1 and 2.
for _module in ("numpy.core.multiarray", "numpy._core.multiarray"):
    _ALLOWED[(_module, "_reconstruct")] = np.empty(0).__reduce__()[0]
    _ALLOWED[(_module, "scalar")] = np.float64(0).__reduce__()[0]


class _Unpickler(pickle.Unpickler):
    """Builds arrays and refuses every other class or function."""

    def __init__(self, stream: BinaryIO, where: str) -> None:
        super().__init__(stream, encoding="latin1")
        self._where = where

    def find_class(self, module: str, name: str) -> Any:
        """Return an allowed constructor.

        Raises:
            UnsafePickle: the pickle asks for anything else.
        """
        try:
            return _ALLOWED[(module, name)]
        except KeyError:
            raise UnsafePickle(
                f"The pickle asks for {module}.{name}, which a body model has no business with; nothing was run.",
                where=self._where,
                hint="Do not open this file with other tools; download the model again from its own site.",
            ) from None


def read_pickle(path: Path) -> dict[str, Any]:
    """Return the arrays of a pickled body model.

    Raises:
        UnsafePickle: the file asks for a class or function other than array constructors.
        BodyInvalid: the file is damaged or is no dictionary.
    """
    try:
        with path.open("rb") as stream:
            content = _Unpickler(stream, str(path)).load()
    except UnsafePickle:
        raise
    except (
        OSError,
        EOFError,
        ValueError,
        TypeError,
        KeyError,
        IndexError,
        AttributeError,
        pickle.UnpicklingError,
    ) as error:
        raise BodyInvalid(
            f"The pickle cannot be read: {error}", where=str(path), hint="The file may be truncated."
        ) from error
    if not isinstance(content, dict):
        raise BodyInvalid(f"The pickle holds a {type(content).__name__}; a dictionary is expected.", where=str(path))
    return {str(key): plain(value) for key, value in content.items()}


def plain(value: Any) -> Any:
    """Return stand-ins as arrays and anything else as it is."""
    return value.array() if isinstance(value, _Chumpy | _SparseColumns) else value
