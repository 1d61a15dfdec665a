"""NumPy under the names of the array API standard.

NumPy has these names itself from version 2.0 on. Blender 4 brings 1.26, and no other package is needed for it.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np


def asarray(value: Any, *, dtype: Any = None, device: Any = None, copy: bool | None = None) -> Any:
    """Return an array. NumPy's are on the CPU."""
    return np.array(value, dtype=dtype) if copy else np.asarray(value, dtype=dtype)


def astype(values: Any, dtype: Any, *, copy: bool = True) -> Any:
    """Return the values in another type."""
    return values.astype(dtype, copy=copy)


def zeros(shape: int | tuple[int, ...], *, dtype: Any = None, device: Any = None) -> Any:
    """Return zeros."""
    return np.zeros(shape, dtype=dtype or np.float64)


def ones(shape: int | tuple[int, ...], *, dtype: Any = None, device: Any = None) -> Any:
    """Return ones."""
    return np.ones(shape, dtype=dtype or np.float64)


def empty(shape: int | tuple[int, ...], *, dtype: Any = None, device: Any = None) -> Any:
    """Return an array to be filled."""
    return np.empty(shape, dtype=dtype or np.float64)


def full(shape: int | tuple[int, ...], value: Any, *, dtype: Any = None, device: Any = None) -> Any:
    """Return an array of one value."""
    return np.full(shape, value, dtype=dtype)


def eye(rows: int, columns: int | None = None, *, dtype: Any = None, device: Any = None) -> Any:
    """Return an identity matrix."""
    return np.eye(rows, columns, dtype=dtype or np.float64)


def arange(start: float, stop: float | None = None, step: float = 1, *, dtype: Any = None, device: Any = None) -> Any:
    """Return evenly spaced values."""
    return np.arange(start, dtype=dtype) if stop is None else np.arange(start, stop, step, dtype=dtype)


def clip(values: Any, min: Any = None, max: Any = None) -> Any:
    """Return the values, no less than ``min`` and no more than ``max`` if given."""
    return values if min is None and max is None else np.clip(values, min, max)


def matrix_transpose(values: Any) -> Any:
    """Exchange the last two axes."""
    return np.swapaxes(values, -1, -2)


def argsort(values: Any, *, axis: int = -1, stable: bool = True) -> Any:
    """Return the places of the values in rising order."""
    return np.argsort(values, axis=axis, kind="stable" if stable else None)


def sort(values: Any, *, axis: int = -1, stable: bool = True) -> Any:
    """Return the values in rising order."""
    return np.sort(values, axis=axis, kind="stable" if stable else None)


def isdtype(dtype: Any, kind: str) -> bool:
    """Return whether a type is of a kind: "bool", "integral" or "real floating"."""
    return np.dtype(dtype).kind in {"bool": "b", "integral": "iu", "real floating": "f"}[kind]


def vector_norm(values: Any, *, axis: int | None = None, keepdims: bool = False) -> Any:
    """Return Euclidean lengths."""
    return np.linalg.norm(values, axis=axis, keepdims=keepdims)


def svd(values: Any, *, full_matrices: bool = True) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the singular value decomposition (U, S, Vh)."""
    return np.linalg.svd(values, full_matrices=full_matrices)


def diagonal(values: Any) -> Any:
    """Return the diagonals of (..., n, n) matrices."""
    return np.diagonal(values, axis1=-2, axis2=-1)


def trace(values: Any) -> Any:
    """Return the traces of (..., n, n) matrices."""
    return np.trace(values, axis1=-2, axis2=-1)


def cross(a: Any, b: Any, *, axis: int = -1) -> Any:
    """Return cross products of vectors."""
    return np.cross(a, b, axis=axis)


_LINALG = SimpleNamespace(
    cross=cross,
    det=np.linalg.det,
    diagonal=diagonal,
    inv=np.linalg.inv,
    solve=np.linalg.solve,
    svd=svd,
    trace=trace,
    vector_norm=vector_norm,
)
_OWN = {
    "acos": np.arccos,
    "arange": arange,
    "argsort": argsort,
    "asarray": asarray,
    "asin": np.arcsin,
    "astype": astype,
    "atan": np.arctan,
    "atan2": np.arctan2,
    "bool": np.bool_,
    "clip": clip,
    "concat": np.concatenate,
    "cumulative_prod": np.cumprod,
    "cumulative_sum": np.cumsum,
    "empty": empty,
    "eye": eye,
    "full": full,
    "isdtype": isdtype,
    "linalg": _LINALG,
    "matrix_transpose": matrix_transpose,
    "ones": ones,
    "permute_dims": np.transpose,
    "pow": np.power,
    "sort": sort,
    "zeros": zeros,
}


class NumpyNamespace:
    """NumPy's functions, the standard's first."""

    def __init__(self) -> None:
        self.__dict__.update(_OWN)

    def __getattr__(self, name: str) -> Any:
        value = getattr(np, name)
        self.__dict__[name] = value
        return value


NUMPY = NumpyNamespace()  # The namespace of NumPy's arrays.
