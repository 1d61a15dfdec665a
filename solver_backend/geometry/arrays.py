"""Create arrays of the caller's kind (NumPy or torch) and device; no other module handles namespaces."""

from __future__ import annotations

from typing import Any

import numpy as np

from solver_backend.exchange.errors import BackendMissing
from solver_backend.geometry.numpy_namespace import NUMPY
from solver_backend.types.shapes import Array as Array


def is_torch(value: Any) -> bool:
    """Return whether a value is a tensor of torch."""
    return type(value).__module__.partition(".")[0] == "torch"


def array_namespace(*values: Any) -> Any:
    """Return the namespace of arrays and numbers: NumPy's, or that of torch if a value is a tensor.

    Raises:
        BackendMissing: a value is a tensor, and array-api-compat is not installed.
    """
    if all(type(value) is np.ndarray for value in values) or not any(map(is_torch, values)):
        return NUMPY
    return torch_namespace()


def torch_namespace() -> Any:
    """Return torch under the names of the array API standard.

    Raises:
        BackendMissing: array-api-compat is not installed.
    """
    try:
        from array_api_compat import torch as namespace
    except ModuleNotFoundError as error:
        raise BackendMissing(
            "Computing with torch needs the package array-api-compat, which is not installed.",
            hint="Install it beside torch with: pip install array-api-compat.",
        ) from error
    return namespace


def device_of(like: Array) -> Any:
    """Return the device that new arrays beside ``like`` belong on; None for the CPU."""
    device = getattr(like, "device", None)
    return None if str(device) == "cpu" else device


def constant(value: Any, like: Array) -> Array:
    """Return ``value`` as an array of the same kind, type and device as ``like``."""
    return array_namespace(like).asarray(value, dtype=like.dtype, device=device_of(like))


def astype(values: Array, precision: Any) -> Array:
    """Return the values in a precision of their own kind; themselves where they have it."""
    return array_namespace(values).astype(values, precision, copy=False)


def solved(A: Array, B: Array) -> Array:
    """Return ``A⁻¹ B`` of (..., n, n) and (..., n, m) arrays.

    Raises:
        LinAlgError: a matrix is singular.
    """
    return array_namespace(A).linalg.solve(A, B)


def index(values: np.ndarray, like: Array) -> Array:
    """Return whole numbers that pick entries of arrays on the device of ``like``."""
    return array_namespace(like).asarray(values, device=device_of(like))


def zeros(shape: int | tuple[int, ...], like: Array, dtype: Any = None) -> Array:
    """Return zeros of the kind, type (unless given) and device of ``like``."""
    return array_namespace(like).zeros(shape, dtype=dtype or like.dtype, device=device_of(like))


def empty(shape: int | tuple[int, ...], like: Array, dtype: Any = None) -> Array:
    """Return an array to be filled, of the kind, type (unless given) and device of ``like``."""
    return array_namespace(like).empty(shape, dtype=dtype or like.dtype, device=device_of(like))


def identity(size: int, like: Array, dtype: Any = None) -> Array:
    """Return the (n, n) identity, of the kind, type (unless given) and device of ``like``."""
    return array_namespace(like).eye(size, dtype=dtype or like.dtype, device=device_of(like))


def unset(shape: tuple[int, ...], like: Array) -> Array:
    """Return a large array to be filled, of the kind, type and device of ``like``.

    On the CPU NumPy allocates it, in huge pages; to write to torch's small pages first takes five times as long.
    """
    if device_of(like) is not None:
        return empty(shape, like)
    return array_namespace(like).asarray(np.empty(shape, dtype=str(like.dtype).removeprefix("torch.")))


def replaced(values: Array, where: Array, by: float) -> Array:
    """Return a copy of the values with a number where the mask is True."""
    copy = array_namespace(values).asarray(values, copy=True)
    copy[where] = by
    return copy


def to_numpy(value: Any) -> np.ndarray:
    """Return a float64 NumPy copy of an array of either kind, on any device."""
    return np.array(value.detach().cpu().numpy() if hasattr(value, "cpu") else value, dtype=np.float64)
