"""Provide NumPy under the function names of the array API standard.

NumPy has these names since version 2.0, but Blender 4 includes NumPy 1.26. With this module no other package is needed.
"""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np


def asarray(value: Any, *, dtype: Any = None, device: Any = None, copy: bool | None = None) -> Any:
    """Return an array on the CPU."""
    return np.array(value, dtype=dtype) if copy else np.asarray(value, dtype=dtype)


def astype(values: Any, dtype: Any, *, copy: bool = True) -> Any:
    """Return the values converted to another type."""
    return values.astype(dtype, copy=copy)


def _on_cpu(create: Callable[..., Any]) -> Callable[..., Any]:
    """Let a NumPy function accept the array API standard's argument ``device`` and ignore it."""

    def call(*arguments: Any, device: Any = None, **given: Any) -> Any:
        return create(*arguments, **given)

    return call


def clip(values: Any, min: Any = None, max: Any = None) -> Any:
    """Limit the values to at least ``min`` and at most ``max``, unless these are None."""
    return values if min is None and max is None else np.clip(values, min, max)


def matrix_transpose(values: Any) -> Any:
    """Swap the last two axes of the values."""
    return np.swapaxes(values, -1, -2)


def argsort(values: Any, *, axis: int = -1, stable: bool = True) -> Any:
    """Return the indices that sort the values in ascending order."""
    return np.argsort(values, axis=axis, kind="stable" if stable else None)


def sort(values: Any, *, axis: int = -1, stable: bool = True) -> Any:
    """Return the values in ascending order."""
    return np.sort(values, axis=axis, kind="stable" if stable else None)


def isdtype(dtype: Any, kind: str) -> bool:
    """Return whether a type is of the kind "bool", "integral" or "real floating"."""
    return np.dtype(dtype).kind in {"bool": "b", "integral": "iu", "real floating": "f"}[kind]


def diagonal(values: Any) -> Any:
    """Return the diagonals of (..., n, n) matrices."""
    return np.diagonal(values, axis1=-2, axis2=-1)


def trace(values: Any) -> Any:
    """Return the traces of (..., n, n) matrices."""
    return np.trace(values, axis1=-2, axis2=-1)


_LINALG = SimpleNamespace(
    cross=np.cross,
    det=np.linalg.det,
    diagonal=diagonal,
    inv=np.linalg.inv,
    solve=np.linalg.solve,
    svd=np.linalg.svd,
    trace=trace,
    vector_norm=np.linalg.norm,
)
_OWN = {
    "acos": np.arccos,
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
    "isdtype": isdtype,
    "linalg": _LINALG,
    "matrix_transpose": matrix_transpose,
    "permute_dims": np.transpose,
    "pow": np.power,
    "sort": sort,
}
_OWN |= {name: _on_cpu(getattr(np, name)) for name in ("arange", "empty", "eye", "full", "ones", "zeros")}


class NumpyNamespace:
    """NumPy with the names and signatures of the array API standard."""

    def __init__(self) -> None:
        self.__dict__.update(_OWN)

    def __getattr__(self, name: str) -> Any:
        value = getattr(np, name)
        self.__dict__[name] = value
        return value


NUMPY = NumpyNamespace()  # The namespace for NumPy arrays.
