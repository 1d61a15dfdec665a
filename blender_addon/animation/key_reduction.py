"""Reduce keys: add keys where the curves deviate most, then move each key to a better frame."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import bpy
import numpy as np

from .._exchange.progress import Progress, silent
from .._exchange.so3 import quat_from_matrix
from ..conventions.skeleton import LAYOUTS, layout_of

_PULL = 1e-3  # Weight that pulls each slope towards its neighbours' slopes, so that every slope is defined.


@dataclass(frozen=True)
class SparseCurves:
    """N cubic Hermite splines that share K keys."""

    frames: np.ndarray  # (K,) frames in the take, ascending.
    values: np.ndarray  # (K, N) values of the take at these frames.
    slopes: np.ndarray  # (K, N) change per frame.

    @classmethod
    def fitted(cls, values: np.ndarray, frames: np.ndarray) -> SparseCurves:
        """Fit curves to (F, N) values by least squares. They are exact at the (K,) key frames."""
        if len(values) == 1:
            return cls(np.zeros(1, int), values, np.zeros_like(values))
        return cls(frames, values[frames], _fit_slopes(values, frames))

    def sampled(self, num_frames: int, dtype: type = np.float64) -> np.ndarray:
        """Evaluate the curves at every frame of the take, and return values (F, N)."""
        if len(self.frames) == 1:
            return np.repeat(self.values.astype(dtype), num_frames, axis=0)
        left, basis = _hermite(self.frames, num_frames)
        found = np.empty((num_frames, self.values.shape[1]), dtype)
        at_ends = np.concatenate([self.values[:, None], self.slopes[:, None]], axis=1).astype(dtype)  # (K, 2, N)
        weights = basis[:, [0, 2, 1, 3]].astype(dtype)
        for piece, (first, stop) in enumerate(pairwise(np.searchsorted(left, np.arange(len(self.frames))).tolist())):
            np.matmul(weights[first:stop], at_ends[piece : piece + 2].reshape(4, -1), out=found[first:stop])
        return found


def _fit_slopes(values: np.ndarray, frames: np.ndarray) -> np.ndarray:
    """Return the slopes (K, N) at the keys that minimise the squared distance to the (F, N) ``values``."""
    _, basis = _hermite(frames, len(values))
    at_keys, pieces = values[frames], frames[:-1]  # ``pieces``: first frame of each piece
    left, right = (np.add.reduceat(basis[:, k, None] * basis, pieces) for k in (2, 3))  # (K - 1, 4) each
    sums, slopes = np.zeros_like(at_keys), basis[:, 2:].T
    for k, (first, stop) in enumerate(pairwise([*pieces.tolist(), len(values)])):
        sums[k : k + 2] += slopes[:, first:stop] @ values[first:stop]
    sums[:-1] -= left[:, :1] * at_keys[:-1] + left[:, 1:2] * at_keys[1:]
    sums[1:] -= right[:, :1] * at_keys[:-1] + right[:, 1:2] * at_keys[1:]
    diagonal = np.append(left[:, 2], 0.0) + np.append(0.0, right[:, 3])
    pull = _PULL * max(1.0, float(diagonal.mean()))
    usual = np.gradient(at_keys, frames, axis=0)
    return _solve_chain(diagonal + pull, right[:, 2], sums + pull * usual)


def _solve_chain(diagonal: np.ndarray, beside: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solve a symmetric tridiagonal system for x (K, N). The diagonal is (K,), the off-diagonal (K - 1,)."""
    rest, rows, off = diagonal.tolist(), list(right.copy()), beside.tolist()  # lists of rows, each a view of one array
    for k, value in enumerate(off, 1):
        factor = value / rest[k - 1]
        rest[k] -= factor * value
        rows[k] -= factor * rows[k - 1]
    rows[-1] /= rest[-1]
    for k in reversed(range(len(off))):
        rows[k] -= off[k] * rows[k + 1]
        rows[k] /= rest[k]
    return np.array(rows)


def _hermite(frames: np.ndarray, num_frames: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the cubic Hermite weights of the keys around every frame.

    The results are the index (F,) of the key before each frame, and the weights (F, 4) of the values at the keys before
    and after the frame, followed by the weights of the slopes at these two keys.
    """
    at = np.arange(num_frames)
    left = np.clip(np.searchsorted(frames, at, "right") - 1, 0, len(frames) - 2)
    length = (frames[left + 1] - frames[left]).astype(float)
    u = (at - frames[left]) / length
    value_right = u * u * (3 - 2 * u)
    slopes = length * u * (1 - u) * (1 - u), -length * u * u * (1 - u)
    return left, np.stack([1 - value_right, value_right, *slopes], axis=1)


_MOVES = (1, -1, 2, -2, 4, -4)  # Trial moves of a key, in candidate frames.
_SWEEPS = 4
_APART = 6  # Keys this far apart are tested together. A key hardly affects the fit three keys away.
_POWER = 6  # Exponent of the power mean that is minimised. It approximates the maximum but is smooth.
_GAIN = 0.02  # Sweeps are repeated while each gains at least this fraction. Chosen by hand.
_UNCHANGED = 2e-6  # A channel difference (in metres or quaternion components) that moves no joint by 0.1 mm.
_SHARE = 8  # Each pass adds one eighth of the missing keys.

ADDING, MOVING, REMOVING = "Adding keys", "Moving keys", "Removing keys"  # Names of the progress stages.
Distance = Callable[[np.ndarray], np.ndarray]
"""Function that returns the distance in metres between (F, N) values and a take, in each frame (F,)."""


def reduce_keys(
    values: np.ndarray, candidates: np.ndarray, count: int, distance: Distance, progress: Progress = silent
) -> SparseCurves:
    """Fit curves with at most ``count`` keys that keep ``distance`` small.

    The keys are the first frame, the last frame and a selection of the frames in ``candidates``.
    """
    last = len(values) - 1
    free = np.unique(np.concatenate([candidates[(candidates > 0) & (candidates < last)], [0, last]]).astype(int))
    laid = _lay(values, free, count, distance, progress)
    return SparseCurves.fitted(values, _move(values, free, laid, distance, progress))


def keys_within(
    values: np.ndarray, distance: Distance, tolerance_m: float, progress: Progress = silent
) -> SparseCurves:
    """Return curves with few keys that stay within ``tolerance_m`` of the take in every frame."""
    free, count = np.arange(len(values)), 2
    keys = free[[0, -1]] if len(values) > 1 else free
    while len(keys) < len(free):
        error = _error(values, keys, distance)
        progress(ADDING, int((error <= tolerance_m).sum()), len(free))
        if error.max() <= tolerance_m:
            break
        pieces = [(a, b) for a, b in pairwise(keys.tolist()) if error[a : b + 1].max() > tolerance_m]
        worst = [int(a + error[a : b + 1].argmax()) for a, b in pieces]
        laid = [frame if a < frame < b else int((a + b) // 2) for frame, (a, b) in zip(worst, pieces, strict=True)]
        keys = np.union1d(keys, [frame for frame, (a, b) in zip(laid, pieces, strict=True) if a < frame < b])
        if len(keys) == count:
            break
        count = len(keys)
    return SparseCurves.fitted(values, _pruned(values, keys, distance, tolerance_m, progress))


def _error(values: np.ndarray, keys: np.ndarray, distance: Distance) -> np.ndarray:
    return distance(SparseCurves.fitted(values, keys).sampled(len(values), np.float32))


def _pruned(
    values: np.ndarray, keys: np.ndarray, distance: Distance, tolerance_m: float, progress: Progress
) -> np.ndarray:
    """Remove keys while the error stays within the tolerance. Test distant keys together to save time."""
    turn = idle = 0
    while idle < _APART and len(keys) > 2:
        progress(REMOVING, turn, turn + _APART - idle)  # at least this many more tests follow
        out = keys[1:-1][turn % _APART :: _APART]
        while len(out):
            kept = np.setdiff1d(keys, out)
            wrong = _error(values, kept, distance) > tolerance_m
            if not wrong.any():
                break
            pieces = np.flatnonzero(np.logical_or.reduceat(wrong, kept[:-1]))
            away = np.abs(np.subtract.outer(np.searchsorted(kept, out) - 1, pieces)).min(axis=1)
            out = out[away > away.min()]  # the keys nearest to a frame outside the tolerance are restored
        keys, turn, idle = np.setdiff1d(keys, out), turn + 1, 0 if len(out) else idle + 1
    return keys


def _lay(values: np.ndarray, free: np.ndarray, count: int, distance: Distance, progress: Progress) -> np.ndarray:
    """Select up to ``count`` of the frames ``free`` as keys. Each step adds keys near the largest errors."""
    keys = free[[0, -1]] if len(values) > 1 else free
    while len(keys) < min(count, len(free)):
        progress(ADDING, len(keys), count)
        error = _error(values, keys, distance)
        open_frames = np.setdiff1d(free, keys)
        pieces = np.searchsorted(keys, open_frames)
        best: dict[int, tuple[float, int]] = {}
        for piece in np.unique(pieces).tolist():
            worst = keys[piece - 1] + int(error[keys[piece - 1] : keys[piece] + 1].argmax())
            inside = open_frames[pieces == piece]
            best[piece] = float(error[worst]), int(inside[np.abs(inside - worst).argmin()])
        ranked = sorted(best.values(), reverse=True)[: max(1, (count - len(keys)) // _SHARE)]
        keys = np.union1d(keys, [frame for _, frame in ranked])
    return keys


def _move(values: np.ndarray, free: np.ndarray, keys: np.ndarray, distance: Distance, progress: Progress) -> np.ndarray:
    """Move each key to a nearby free frame if that reduces the distances. Return the new key frames.

    To save time, keys that are far apart are tested together.
    """
    if len(keys) < 3:
        return keys
    cost = _error(values, keys, distance) ** _POWER
    for sweep in range(_SWEEPS):
        before = float(cost.sum(dtype=float))
        for turn in range(_APART):
            progress(MOVING, sweep * _APART + turn, _SWEEPS * _APART)
            chosen = np.arange(1 + turn, len(keys) - 1, _APART)
            ends = keys[np.maximum(chosen - 3, 0)], keys[np.minimum(chosen + 3, len(keys) - 1)]
            best, moved, at = _between(cost, *ends), keys.copy(), np.searchsorted(free, keys[chosen])
            for step in _MOVES:
                to = free[np.clip(at + step, 0, len(free) - 1)]
                fits = (to > keys[chosen - 1]) & (to < keys[chosen + 1])
                tried = keys.copy()
                tried[chosen[fits]] = to[fits]
                found = _between(_error(values, tried, distance) ** _POWER, *ends)
                better = fits & (found < best)
                best, moved[chosen[better]] = np.where(better, found, best), to[better]
            if (moved != keys).any() and (found := _error(values, moved, distance) ** _POWER).sum(
                dtype=float
            ) < cost.sum(dtype=float):
                keys, cost = moved, found
        if cost.sum(dtype=float) > before * (1 - _GAIN) ** _POWER:
            break
    return keys


def _between(cost: np.ndarray, first: np.ndarray, last: np.ndarray) -> np.ndarray:
    """Return the sum of an (F,) cost over each frame range from ``first`` to ``last``, both included."""
    total = np.concatenate([[0.0], np.cumsum(cost, dtype=np.float64)])
    return total[last + 1] - total[first]


@dataclass(frozen=True)
class KeyDeviation:
    """Largest differences between a take with sparse keys and the full take, over all frames and joints."""

    keys: int
    joints_mm: float  # Distance between joint positions.
    degrees: float  # Angle between joint rotations relative to their parents.

    def __str__(self) -> str:
        off = f"Joints are up to {self.joints_mm:.1f} mm and {self.degrees:.1f}° from the take."
        return f"{self.keys} keys remain. {off}"


def thin_channels(
    channels: np.ndarray,
    armature: bpy.types.Object,
    keyframes: np.ndarray | None,
    count: int,
    tolerance_mm: float | None = None,
    progress: Progress = silent,
) -> tuple[SparseCurves, KeyDeviation]:
    """Reduce (F, 3 + 4 J) channels to ``count`` keys, or to as many as ``tolerance_mm`` requires."""
    frames = len(channels)
    candidates = np.arange(frames) if keyframes is None else np.flatnonzero(keyframes)
    heads, axes = rest_of(armature)
    whole = channels.astype(np.float32)
    joints, room = _posed(whole, heads, axes)[::-1]
    seen, known = whole.copy(), np.zeros(frames, np.float32)

    def apart(found: np.ndarray) -> np.ndarray:
        """Return each frame's largest joint error (F,) in metres. Recompute only frames that have changed."""
        changed = np.flatnonzero(np.abs(found - seen).max(axis=1) > _UNCHANGED)
        seen[changed] = found[changed]
        off = _posed(seen[changed], heads, axes, room)[1]
        off -= np.take(joints, changed, axis=-1)
        off *= off
        known[changed] = np.sqrt(off.sum(axis=1).max(axis=0))
        return known.copy()

    if tolerance_mm is None:
        curves = reduce_keys(channels, candidates, max(2, count), apart, progress)
    else:
        curves = keys_within(channels, apart, 1e-3 * tolerance_mm, progress)
    found = curves.sampled(frames)
    cosine = np.abs((_quaternions(found) * _quaternions(channels)).sum(-1)).clip(max=1)
    degrees, joints_mm = float(np.degrees(2 * np.arccos(cosine)).max()), float(1000 * apart(found).max())
    return curves, KeyDeviation(len(curves.frames), joints_mm, degrees)


def rest_of(armature: bpy.types.Object) -> tuple[np.ndarray, np.ndarray]:
    """Return the heads (J, 3) and axes (J, 3, 3) of the bones at rest, in the armature's frame."""
    bones = armature.data.bones
    rest = np.array([bones[joint].matrix_local for joint in layout_of(bones).joints], dtype=np.float64)
    return rest[:, :3, 3], rest[:, :3, :3]


def _quaternions(channels: np.ndarray) -> np.ndarray:
    quat = channels[:, 3:].reshape(len(channels), -1, 4)
    return quat / np.linalg.norm(quat, axis=-1, keepdims=True)


def posed_joints(channels: np.ndarray, heads: np.ndarray, axes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return joint rotations (F, J, 3, 3) and positions (F, J, 3) in the armature's frame.

    ``G_j = G_p A_p^T A_j R_j``, ``p_j = p_p + G_p A_p^T (h_j - h_p)``, where p is the parent of joint j.

    Args:
        channels: (F, 3 + 4 J) channels (see ``thin_channels``).
        heads: (J, 3) rest positions h of the heads.
        axes: (J, 3, 3) rest axes A.
    """
    G, p = _posed(channels, heads, axes)
    return np.moveaxis(G, -1, 0), np.moveaxis(p, -1, 0)


def _posed(
    channels: np.ndarray, heads: np.ndarray, axes: np.ndarray, room: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Return ``posed_joints`` with frames on the last axis, so that each operation covers all frames.

    Args:
        room: (J, 3, 3, at least F) array to hold the rotations. Reusing it avoids slow memory allocations.
    """
    parents = np.array(next(layout.parents for layout in LAYOUTS if layout.num_joints == len(heads)))
    up, dtype, frames = np.swapaxes(axes[parents], 1, 2), channels.dtype, len(channels)
    steps, offsets = up @ axes, (up @ (heads - heads[parents])[..., None]).astype(dtype)
    steps[0] = axes[0]
    a, b, c, d = np.moveaxis(quat_from_matrix(steps), -1, 0)
    product = np.array([[a, -b, -c, -d], [b, a, -d, c], [c, d, a, -b], [d, -c, b, a]]).transpose(2, 0, 1).astype(dtype)
    quaternions = product @ channels.T[3:].reshape(len(heads), 4, -1)
    w, x, y, z = np.swapaxes(quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True), 0, 1)
    G = np.empty((len(heads), 3, 3, frames), dtype) if room is None else room[..., :frames]
    for k, (a, b, c) in enumerate(((x, y, z), (y, z, x), (z, x, y))):
        after = (k + 1) % 3
        G[:, k, k] = 1 - 2 * (b * b + c * c)
        G[:, k, after], G[:, after, k] = 2 * (a * b - w * c), 2 * (a * b + w * c)
    p = np.empty((len(heads), 3, frames), dtype)
    p[0] = (heads[0] + channels[:, :3] @ axes[0].T).T
    for k, parent in enumerate(parents[1:], 1):
        first, second, third = np.swapaxes(G[parent], 0, 1)
        p[k] = p[parent] + first * offsets[k, 0] + second * offsets[k, 1] + third * offsets[k, 2]
        G[k] = first[:, None] * G[k, 0] + second[:, None] * G[k, 1] + third[:, None] * G[k, 2]
    return G, p
