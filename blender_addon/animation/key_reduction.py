"""Key reduction: place keys where a take deviates most, then move them to where they serve best."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass
from itertools import pairwise
from typing import Protocol

import bpy
import numpy as np

from .._exchange.so3 import matrix_from_quat
from ..conventions.skeleton import LAYOUTS, layout_of

_PULL = 1e-3  # Weight that draws slopes to those of the neighbours, so that adjacent keys have defined slopes.


@dataclass(frozen=True)
class SparseCurves:
    """N cubic Hermite splines that share K keys."""

    frames: np.ndarray  # (K,) frames of the take, ascending.
    values: np.ndarray  # (K, N) values of the take at the keys.
    slopes: np.ndarray  # (K, N) per frame.

    @classmethod
    def fitted(cls, values: np.ndarray, frames: np.ndarray) -> SparseCurves:
        """Return the curves through frames (K,) of whole curves (F, N) that fit best between them."""
        if len(values) == 1:
            return cls(np.zeros(1, int), values, np.zeros_like(values))
        return cls(frames, values[frames], _fit_slopes(values, frames))

    def sampled(self, num_frames: int) -> np.ndarray:
        """Return the (F, N) values on every frame of the take."""
        if len(self.frames) == 1:
            return np.repeat(self.values, num_frames, axis=0)
        left, basis = _hermite(self.frames, num_frames)
        at_left, at_right, slope_left, slope_right = basis.T[..., None]
        ends = at_left * self.values[left] + at_right * self.values[left + 1]
        return ends + slope_left * self.slopes[left] + slope_right * self.slopes[left + 1]


def _fit_slopes(values: np.ndarray, frames: np.ndarray) -> np.ndarray:
    """Return the (K, N) slopes at the keys that minimise the squared distance of the curves from ``values`` (F, N)."""
    left, basis = _hermite(frames, len(values))
    at_keys = values[frames]
    rest = values - basis[:, :1] * at_keys[left] - basis[:, 1:2] * at_keys[left + 1]
    normal = np.zeros((len(frames), len(frames)))
    right = np.zeros_like(at_keys)
    for side in (0, 1):
        np.add.at(right, left + side, basis[:, 2 + side, None] * rest)
        for other in (0, 1):
            np.add.at(normal, (left + side, left + other), basis[:, 2 + side] * basis[:, 2 + other])
    pull = _PULL * max(1.0, float(normal.diagonal().mean()))
    usual = np.gradient(at_keys, frames, axis=0)
    return np.linalg.solve(normal + pull * np.eye(len(frames)), right + pull * usual)


def _hermite(frames: np.ndarray, num_frames: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the key before each frame (F,) and the weights (F, 4) of the values and slopes on both sides of it."""
    at = np.arange(num_frames)
    left = np.clip(np.searchsorted(frames, at, "right") - 1, 0, len(frames) - 2)
    length = (frames[left + 1] - frames[left]).astype(float)
    u = (at - frames[left]) / length
    value_right = u * u * (3 - 2 * u)
    slopes = length * u * (1 - u) * (1 - u), -length * u * u * (1 - u)
    return left, np.stack([1 - value_right, value_right, *slopes], axis=1)


_MOVES = (1, -1, 2, -2, 4, -4)  # Trial moves of a key in candidates.
_SWEEPS = 4
_NEIGHBOURS = 3
"""Keys on each side that are refitted with a moved key. A more distant key changes the fit by about a hundredth."""
_POWER = 6  # Power of the mean that moves minimise: close to the largest distance, but smooth.
_SHARE = 8  # Each pass over the take places one in this many of the missing keys.


class Distance(Protocol):
    """Distance of values from a take."""

    def __call__(self, first: int, found: np.ndarray) -> np.ndarray:
        """Return (n,) metres for values (n, N) of the frames from ``first`` on."""
        ...


def reduce_keys(values: np.ndarray, candidates: np.ndarray, count: int, distance: Distance) -> SparseCurves:
    """Return curves with at most ``count`` keys, at the ends and where (F, N) curves need them of ``candidates``."""
    last = len(values) - 1
    free = np.unique(np.concatenate([candidates[(candidates > 0) & (candidates < last)], [0, last]]).astype(int))
    return SparseCurves.fitted(values, _move(values, free, _lay(values, free, count, distance), distance))


def keys_within(values: np.ndarray, distance: Distance, tolerance_m: float) -> SparseCurves:
    """Return curves within a tolerance: add keys at the worst frames, then remove the unnecessary ones."""
    free, count = np.arange(len(values)), 2
    keys = free[[0, -1]] if len(values) > 1 else free
    while len(keys) < len(free):
        error = distance(0, SparseCurves.fitted(values, keys).sampled(len(values)))
        if error.max() <= tolerance_m:
            break
        pieces = [(a, b) for a, b in pairwise(keys.tolist()) if error[a : b + 1].max() > tolerance_m]
        worst = [int(a + error[a : b + 1].argmax()) for a, b in pieces]
        laid = [frame if a < frame < b else int((a + b) // 2) for frame, (a, b) in zip(worst, pieces, strict=True)]
        keys = np.union1d(keys, [frame for frame, (a, b) in zip(laid, pieces, strict=True) if a < frame < b])
        if len(keys) == count:
            break
        count = len(keys)
    return SparseCurves.fitted(values, _pruned(values, keys, distance, tolerance_m))


def _pruned(values: np.ndarray, keys: np.ndarray, distance: Distance, tolerance_m: float) -> np.ndarray:
    taken = keys.tolist()
    k = 1
    while k < len(taken) - 1:
        first, stop = max(0, k - _NEIGHBOURS), min(len(taken), k + _NEIGHBOURS + 1)
        around = [*taken[first:k], *taken[k + 1 : stop]]
        start, part = around[0], values[around[0] : around[-1] + 1]
        found = SparseCurves.fitted(part, np.array(around) - start).sampled(len(part))
        if distance(start, found).max() <= tolerance_m:
            without = np.array([*taken[:k], *taken[k + 1 :]])
            # Frames beyond the neighbours change a little, too: the whole take decides.
            if distance(0, SparseCurves.fitted(values, without).sampled(len(values))).max() <= tolerance_m:
                taken.pop(k)
                continue
        k += 1
    return np.array(taken)


def _lay(values: np.ndarray, free: np.ndarray, count: int, distance: Distance) -> np.ndarray:
    """Return keys, added at the worst frames of the worst pieces until there are enough or no frame is left."""
    keys = free[[0, -1]] if len(values) > 1 else free
    while len(keys) < min(count, len(free)):
        error = distance(0, SparseCurves.fitted(values, keys).sampled(len(values)))
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


def _move(values: np.ndarray, free: np.ndarray, keys: np.ndarray, distance: Distance) -> np.ndarray:
    """Return the keys, each moved to a nearby candidate as long as that reduces the distances around it."""
    taken = keys.tolist()
    for _ in range(_SWEEPS):
        before = list(taken)
        for k in range(1, len(taken) - 1):
            first, stop = max(0, k - _NEIGHBOURS), min(len(taken), k + _NEIGHBOURS + 1)
            around = taken[first:stop]
            least = _cost(values, around, distance)
            at = bisect_left(free, taken[k])
            for index in (at + move for move in _MOVES if 0 <= at + move < len(free)):
                if not taken[k - 1] < free[index] < taken[k + 1]:
                    continue
                tried = [*taken[first:k], int(free[index]), *taken[k + 1 : stop]]
                cost = _cost(values, tried, distance)
                if cost < least:
                    least, taken[k] = cost, int(free[index])
        if taken == before:
            break
    return np.array(taken)


def _cost(values: np.ndarray, keys: list[int], distance: Distance) -> float:
    first, stop = keys[0], keys[-1] + 1
    part = values[first:stop]
    found = SparseCurves.fitted(part, np.array(keys) - first).sampled(len(part))
    return float((distance(first, found) ** _POWER).sum())


@dataclass(frozen=True)
class KeyDeviation:
    """Largest differences between a take with few keys and the full take, over all frames and joints."""

    keys: int
    joints_mm: float  # Joint positions.
    degrees: float  # Rotations of the joints against their parents.

    def __str__(self) -> str:
        off = f"joints are up to {self.joints_mm:.1f} mm and {self.degrees:.1f}° from the take."
        return f"{self.keys} keys are left: {off}"


def thin_channels(
    channels: np.ndarray,
    armature: bpy.types.Object,
    keyframes: np.ndarray | None,
    count: int,
    tolerance_mm: float | None = None,
) -> tuple[SparseCurves, KeyDeviation]:
    """Return few keys for (F, 3 + 4 J) channels: ``count`` of the (F,) keyframes, or as many as the tolerance needs."""
    frames = len(channels)
    candidates = np.arange(frames) if keyframes is None else np.flatnonzero(keyframes)
    heads, axes = rest_of(armature)
    joints = posed_joints(channels, heads, axes)[1]

    def apart(first: int, found: np.ndarray) -> np.ndarray:
        """Return (n,) metres that the worst joint is off."""
        off = posed_joints(found, heads, axes)[1] - joints[first : first + len(found)]
        return np.linalg.norm(off, axis=-1).max(axis=1)

    if tolerance_mm is None:
        curves = reduce_keys(channels, candidates, max(2, count), apart)
    else:
        curves = keys_within(channels, apart, 1e-3 * tolerance_mm)
    found = curves.sampled(frames)
    cosine = np.abs((_quaternions(found) * _quaternions(channels)).sum(-1)).clip(max=1)
    degrees, joints_mm = float(np.degrees(2 * np.arccos(cosine)).max()), float(1000 * apart(0, found).max())
    return curves, KeyDeviation(len(curves.frames), joints_mm, degrees)


def rest_of(armature: bpy.types.Object) -> tuple[np.ndarray, np.ndarray]:
    """Return heads (J, 3) and axes (J, 3, 3) of the bones at rest, in the armature's frame."""
    bones = armature.data.bones
    rest = np.array([bones[joint].matrix_local for joint in layout_of(bones).joints], dtype=np.float64)
    return rest[:, :3, 3], rest[:, :3, :3]


def _quaternions(channels: np.ndarray) -> np.ndarray:
    quat = channels[:, 3:].reshape(len(channels), -1, 4)
    return quat / np.linalg.norm(quat, axis=-1, keepdims=True)


def posed_joints(channels: np.ndarray, heads: np.ndarray, axes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return rotations (F, J, 3, 3) and positions (F, J, 3) of bones in the armature's frame.

    ``G_j = G_p A_p^T A_j R_j``, ``p_j = p_p + G_p A_p^T (h_j - h_p)``.

    Args:
        channels: (F, 3 + 4 J), see ``thin_channels``.
        heads: (J, 3) h at rest.
        axes: (J, 3, 3) A at rest.
    """
    R = matrix_from_quat(_quaternions(channels))
    G, p = np.empty_like(R), np.empty(R.shape[:3])
    G[:, 0], p[:, 0] = axes[0] @ R[:, 0], heads[0] + channels[:, :3] @ axes[0].T
    parents = next(layout.parents for layout in LAYOUTS if layout.num_joints == len(heads))
    for j, parent in enumerate(parents[1:], 1):
        rotated = G[:, parent] @ axes[parent].T
        G[:, j] = rotated @ axes[j] @ R[:, j]
        p[:, j] = p[:, parent] + rotated @ (heads[j] - heads[parent])
    return G, p
