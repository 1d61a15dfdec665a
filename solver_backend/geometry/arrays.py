"""Create NumPy arrays or torch tensors that match the caller's arrays in kind, type and device."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cache
from typing import Any, Literal, TypeVar

import numpy as np

from solver_backend.exchange.errors import BackendMissing
from solver_backend.geometry.numpy_namespace import NUMPY
from solver_backend.types.shapes import Array as Array


def is_torch(value: Any) -> bool:
    """Return whether a value is a torch tensor."""
    return type(value).__module__.partition(".")[0] == "torch"


def array_namespace(*values: Any) -> Any:
    """Return the array namespace of torch if a value is a tensor, otherwise of NumPy.

    Raises:
        BackendMissing: a value is a tensor, and array-api-compat is not installed.
    """
    if all(type(value) is np.ndarray for value in values) or not any(map(is_torch, values)):
        return NUMPY
    return torch_namespace()


def torch_namespace() -> Any:
    """Return torch under the function names of the array API standard.

    Raises:
        BackendMissing: array-api-compat is not installed.
    """
    try:
        from array_api_compat import torch as namespace
    except ModuleNotFoundError as error:
        raise BackendMissing(
            "Computing with torch needs the package array-api-compat, which is not installed.",
            hint="Install it next to torch with: pip install array-api-compat.",
        ) from error
    return namespace


def device_of(like: Array) -> Any:
    """Return the device of ``like`` on which to create new arrays, or None for the CPU."""
    device = getattr(like, "device", None)
    return None if str(device) == "cpu" else device


def constant(value: Any, like: Array) -> Array:
    """Convert ``value`` to a NumPy array or torch tensor with the data type and device of ``like``."""
    return array_namespace(like).asarray(value, dtype=like.dtype, device=device_of(like))


def astype(values: Array, precision: Any) -> Array:
    """Convert values to the given precision. Return them unchanged if they already have it."""
    return array_namespace(values).astype(values, precision, copy=False)


def solved(A: Array, B: Array) -> Array:
    """Solve the linear systems ``A X = B`` for matrices A (..., n, n) and B (..., n, m).

    Raises:
        LinAlgError: a matrix is singular.
    """
    return array_namespace(A).linalg.solve(A, B)


def index(values: np.ndarray, like: Array) -> Array:
    """Convert integer indices to an array on the same device as ``like``."""
    return array_namespace(like).asarray(values, device=device_of(like))


def zeros(shape: int | tuple[int, ...], like: Array, dtype: Any = None) -> Array:
    """Return a NumPy array or torch tensor of zeros, with the data type (by default) and device of ``like``."""
    return array_namespace(like).zeros(shape, dtype=dtype or like.dtype, device=device_of(like))


def empty(shape: int | tuple[int, ...], like: Array, dtype: Any = None) -> Array:
    """Return an uninitialised NumPy array or torch tensor, with the data type (by default) and device of ``like``."""
    return array_namespace(like).empty(shape, dtype=dtype or like.dtype, device=device_of(like))


def identity(size: int, like: Array, dtype: Any = None) -> Array:
    """Return the (n, n) identity matrix, with the library, data type (by default) and device of ``like``."""
    return array_namespace(like).eye(size, dtype=dtype or like.dtype, device=device_of(like))


def unset(shape: tuple[int, ...], like: Array) -> Array:
    """Return an uninitialised array or tensor for large results, with the data type and device of ``like``.

    On the CPU, NumPy allocates the memory even for torch tensors, because it uses huge pages. The first write to the
    small pages that torch uses takes five times as long.
    """
    if device_of(like) is not None:
        return empty(shape, like)
    return array_namespace(like).asarray(np.empty(shape, dtype=str(like.dtype).removeprefix("torch.")))


def replaced(values: Array, where: Array, by: float) -> Array:
    """Return a copy of the values with ``by`` wherever the mask ``where`` is true."""
    copy = array_namespace(values).asarray(values, copy=True)
    copy[where] = by
    return copy


def to_numpy(value: Any) -> np.ndarray:
    """Copy a NumPy array, or a torch tensor on any device, to a float64 NumPy array."""
    return np.array(value.detach().cpu().numpy() if hasattr(value, "cpu") else value, dtype=np.float64)


def true_runs(mask: np.ndarray) -> list[tuple[int, int]]:
    """Return the first and last index of each run of true values in a mask (F,), in order."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], np.asarray(mask, dtype=bool), [False]]).astype(np.int8)))
    return [(int(first), int(stop) - 1) for first, stop in edges.reshape(-1, 2)]


def nearest_true(mask: np.ndarray, axis: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return, at each index of an axis, the last true index at or before it, and the first true index at or after it.

    If there is none, the result is -1 or the length of the axis.
    """
    number = np.arange(mask.shape[axis]).reshape(-1, *[1] * (mask.ndim - axis - 1))
    before = np.maximum.accumulate(np.where(mask, number, -1), axis=axis)
    after = np.flip(np.where(mask, number, len(number)), axis)
    return before, np.flip(np.minimum.accumulate(after, axis=axis), axis)


def bridges(known: np.ndarray, longest: int, axis: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the two known frames between which each frame of a short gap lies, and its position from 0 to 1.

    Gaps have at most ``longest`` frames. All other frames, known or not, are returned twice with the position 0.
    """
    before, after = nearest_true(known, axis)
    number = np.arange(known.shape[axis]).reshape(-1, *[1] * (known.ndim - axis - 1))
    is_short = (before >= 0) & (after < len(number)) & (after - before <= longest + 1)
    before, after = np.where(is_short, before, number), np.where(is_short, after, number)
    return before, after, (number - before) / np.maximum(after - before, 1)


def best_states(unary: np.ndarray, transition: np.ndarray) -> np.ndarray:
    """Return the (..., F) states that minimise ``Σ_f u_f(s_f) + Σ_f T_f(s_{f-1}, s_f)`` (Viterbi 1967).

    The costs are u (..., F, 2) for each state, and T (..., F, 2, 2) for each transition from the previous frame's
    state. State 0 wins if both have equal costs.
    """
    cost, before = unary[..., 0, :], list[np.ndarray]()
    for f in range(1, unary.shape[-2]):
        ways = cost[..., :, None] + transition[..., f, :, :]
        before.append(ways[..., 1, :] < ways[..., 0, :])
        cost = ways.min(axis=-2) + unary[..., f, :]
    states = [cost[..., 1] < cost[..., 0]]
    for came in reversed(before):
        states.append(np.where(states[-1], came[..., 1], came[..., 0]))
    return np.stack(states[::-1], axis=-1)


_ROUNDED = {"lower": np.floor, "nearest": np.rint}


def quantile(
    values: np.ndarray,
    share: float,
    axis: int | tuple[int, ...],
    method: Literal["linear", "lower", "nearest"] = "linear",
) -> np.ndarray:
    """Return a quantile of the finite values along axes, or NaN if there are none.

    The result equals ``numpy.nanquantile``: of n sorted values, it is the one at position ``(n - 1) share``. Between
    two values it is interpolated (Hyndman and Fan 1996, definition 7), or ``method`` selects one of them.
    """
    axes = (axis,) if isinstance(axis, int) else axis
    moved = np.moveaxis(values, axes, range(-len(axes), 0))
    shape = moved.shape[: values.ndim - len(axes)]
    if not values.size:
        return np.full(shape, np.nan)
    rows = moved.reshape(*shape, -1)
    known = np.isfinite(rows)
    ordered = np.sort(np.where(known, rows, np.nan), axis=-1)
    place = np.maximum(known.sum(axis=-1, keepdims=True) - 1, 0) * share
    if method != "linear":
        return np.take_along_axis(ordered, _ROUNDED[method](place).astype(int), -1)[..., 0]
    low, high = np.floor(place).astype(int), np.ceil(place).astype(int)
    below, above = np.take_along_axis(ordered, low, -1), np.take_along_axis(ordered, high, -1)
    return (below + (place - low) * (above - below))[..., 0]


_FAST = ("openblas", "mkl", "accelerate", "blis", "armpl")  # BLAS libraries that use cache blocking.


def times_transposed(x: Array, weight: Array) -> Array:
    """Return the (N, m) product ``x Wᵀ`` of (N, k) and (m, k) arrays, quickly even without a fast BLAS.

    Blender builds from Linux distributions use the reference BLAS, and official Blender builds contain none. Both reach
    2.5 GFLOP/s in single precision. NumPy's ``einsum``, which sums along contiguous k, reaches 11.
    """
    if isinstance(x, np.ndarray) and not has_fast_blas():
        return np.einsum("nk,mk->nm", x, weight)
    return array_namespace(x).matmul(x, weight.T)


@cache
def has_fast_blas() -> bool:
    """Return whether NumPy was built with a fast BLAS library."""
    show: Any = np.show_config
    built = show(mode="dicts")
    name = str(built.get("Build Dependencies", {}).get("blas", {}).get("name", "")).lower()
    return any(library in name for library in _FAST)


R = TypeVar("R", bound="Rows")


@dataclass(frozen=True)
class Rows:
    """Base class for tables of arrays with one row per frame or keyframe. Fields may be None."""

    @property
    def arrays(self) -> tuple[Array | None, ...]:
        """The value of each field, an array or None, in the order of the fields."""
        return tuple(getattr(self, field.name) for field in fields(self))

    def _replaced_by(self: R, values: Iterable[Array | None]) -> R:
        return replace(self, **dict(zip((field.name for field in fields(self)), values, strict=True)))

    def select(self: R, frames: Any) -> R:
        """Return the rows selected by indices, a slice or a mask."""
        return self._replaced_by(None if part is None else part[frames] for part in self.arrays)

    def astype(self: R, precision: Any) -> R:
        """Convert the rows to the given precision."""
        return self._replaced_by(None if part is None else astype(part, precision) for part in self.arrays)

    def where(self: R, mask: Array, other: R) -> R:
        """Return these rows where the mask is true, and rows of ``other`` where it is false."""
        xp = array_namespace(mask)

        def pick(own: Array | None, others: Array | None) -> Array | None:
            if own is None or others is None:
                return own
            return xp.where(xp.reshape(mask, (-1, *[1] * (own.ndim - 1))), own, others)

        return self._replaced_by(map(pick, self.arrays, other.arrays))

    @classmethod
    def concatenate(cls, parts: Sequence[R]) -> R:
        """Concatenate the rows of all parts."""
        columns = list(zip(*(part.arrays for part in parts), strict=True))
        xp = array_namespace(columns[0][0])
        return parts[0]._replaced_by(None if column[0] is None else xp.concat(column) for column in columns)
