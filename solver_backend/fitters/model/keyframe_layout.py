"""Define the frame numbers of keyframes, and the frames in their windows (thesis 6.2.5)."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import reduce
from operator import mul
from typing import TYPE_CHECKING, Protocol

import numpy as np

from solver_backend.fitters.model.subject import Keyframes
from solver_backend.geometry.arrays import Array, Rows, array_namespace, constant, to_numpy

if TYPE_CHECKING:
    from solver_backend.fitters.keyframes.frame_range import FrameRange


@dataclass(frozen=True)
class KeyframeLayout:
    """Keyframes of N windows over F frames.

    Window w has the keyframes n w to n w + n, so two neighbouring windows share a keyframe. Solves of a whole
    take use splines and priors on keyframes, which require n = 2.
    """

    bounds: np.ndarray  # (N + 1,) ascending frame numbers where windows meet, from the first frame to the last.
    free: int = 2  # n, the number of keys that each window adds, as in SIDER-n.

    @classmethod
    def even(cls, num_frames: int, window: int, first: int = 0, free: int = 2) -> KeyframeLayout:
        """Divide F >= 2 frames, starting at ``first``, into windows of about ``window`` frames."""
        count = max(1, round((num_frames - 1) / window))
        return cls(first + np.round(np.linspace(0, num_frames - 1, count + 1)).astype(np.int64), free)

    @property
    def num_windows(self) -> int:
        """Number of windows, N."""
        return len(self.bounds) - 1

    @property
    def num_keys(self) -> int:
        """Number of keyframes, n N + 1."""
        return self.free * self.num_windows + 1

    @property
    def key_times(self) -> np.ndarray:
        """(n N + 1,) frame number of each keyframe. It may be fractional inside a window."""
        times = np.empty(self.num_keys)
        times[:: self.free] = self.bounds
        for key in range(1, self.free):
            share = key / self.free
            times[key :: self.free] = (1 - share) * self.bounds[:-1] + share * self.bounds[1:]
        return times

    @property
    def frames(self) -> np.ndarray:
        """(F,) frame numbers from the first frame of the first window to the last frame of the last window."""
        return np.arange(self.bounds[0], self.bounds[-1] + 1)

    def positions(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the window of each frame number, and the position within the window from 0 to 1."""
        window = np.clip(np.searchsorted(self.bounds, times, side="left") - 1, 0, self.num_windows - 1)
        return window, (times - self.bounds[window]) / np.diff(self.bounds)[window]

    def spline_shares(self, window: np.ndarray, time: np.ndarray) -> np.ndarray:
        """Return the spline weights (..., 5) of the control points at positions within windows.

        ``Σ_k B_k(t) c_k`` with cubic B-splines at the keyframes' times has continuous velocity and acceleration. An
        additional point beyond each end is ``3 c_0 - 3 c_1 + c_2``, so that there are as many free points as keyframes.
        Reference: de Boor 1972, "On calculating with B-splines".
        """
        late = (time >= 0.5).astype(int)
        key, u, last = 2 * window + late, 2.0 * time - late, self.num_keys - 1
        steps = np.diff(self.key_times)
        knots = np.concatenate([[steps[0]] * 3, steps, [steps[-1]] * 3]).cumsum()
        knots = np.concatenate([[0.0], knots])  # key k is at 3 + k
        at = knots[key + 3] + u * (knots[key + 4] - knots[key + 3])
        basis, none = [np.ones_like(at)], np.zeros_like(at)
        for degree in (1, 2, 3):
            before = [at - knots[key + 4 - degree + i] for i in range(degree)]
            after = [knots[key + 4 + i] - at for i in range(degree)]
            parts = [value / (before[i] + after[i]) for i, value in enumerate(basis)]
            falling = [*(a * part for a, part in zip(after, parts, strict=True)), none]
            rising = [none, *(b * part for b, part in zip(before, parts, strict=True))]
            basis = [a + b for a, b in zip(falling, rising, strict=True)]
        shares = np.zeros((*time.shape, 5))
        for i, value in enumerate(basis):
            np.put_along_axis(shares, (late + i)[..., None], value[..., None], axis=-1)
        for beyond, outer, inner in ((key == 0, 0, slice(1, 4)), (key + 1 == last, 4, slice(3, 0, -1))):
            shares[beyond, inner] += shares[beyond, outer, None] * [3.0, -3.0, 1.0]
            shares[beyond, outer] = 0.0
        return shares

    def rows(self, stride: int = 1) -> WindowRows:
        """Return every ``stride``-th frame of each window, weighted by the number of frames that it represents."""
        first, last = self.bounds[:-1] + 1, self.bounds[1:]
        first[0] -= 1
        width = int((last - first).max()) // stride + 1
        frames = first[:, None] + stride * np.arange(width)
        inside = frames <= last[:, None]
        frames = np.where(inside, frames, last[:, None])
        time = (frames - self.bounds[:-1, None]) / np.diff(self.bounds)[:, None]
        return WindowRows(frames, time, float(stride) * inside)

    def gaps(self, seen: np.ndarray) -> np.ndarray:
        """Return a (2N,) mask of the intervals between keyframes that contain no ``seen`` frame."""
        before = np.concatenate([[0], np.cumsum(seen)])
        first, last = np.ceil(self.key_times[:-1]).astype(int), np.floor(self.key_times[1:]).astype(int)
        return before[last + 1] == before[first]

    def part(self, windows: slice) -> KeyframeLayout:
        """Return the layout of a range of windows."""
        return KeyframeLayout(self.bounds[windows.start : windows.stop + 1], self.free)


def range_layout(frame_range: FrameRange, num_frames: int, window: int) -> tuple[KeyframeLayout, np.ndarray]:
    """Return the windows of a frame range, with one more window on either side, and a mask of free keyframes.

    There are keyframes at the range's ends, at the pins, and at equal distances between them. The keyframes inside the
    range are free, except the pins. An end of the range is only free if it is also an end of the take. ``window`` is
    the window length in frames.
    """
    stops = sorted({frame_range.first, frame_range.last, *(pin.frame for pin in frame_range.pins)})
    parts = [KeyframeLayout.even(b - a + 1, window, a).bounds for a, b in itertools.pairwise(stops)]
    low, high = max(0, frame_range.first - window), min(num_frames - 1, frame_range.last + window)
    bounds = np.unique(np.concatenate([[low], *parts, [high]]))
    layout = KeyframeLayout(bounds)
    times = layout.key_times
    free = (times > frame_range.first) & (times < frame_range.last)
    free |= (times == 0) & (frame_range.first == 0) | (times == num_frames - 1) & (frame_range.last == num_frames - 1)
    return layout, free & ~np.isin(times, [pin.frame for pin in frame_range.pins])


@dataclass(frozen=True)
class WindowRows(Rows):
    """Frames of N windows, as one row of n frames per window. Shorter rows are padded with frames of weight 0."""

    frames: np.ndarray  # (N, n) frame numbers.
    time: np.ndarray  # (N, n) positions in the window, 0..1.
    weight: np.ndarray  # (N, n) number of frames that each frame represents, 0 in the padding.

    def blocks(self, num_frames: int) -> list[slice]:
        """Divide the windows into an even number of ranges, each with up to ``num_frames`` frames."""
        count, width = self.frames.shape
        pairs = -(-count * width // (2 * num_frames))
        bounds = np.round(np.linspace(0, count, min(2 * pairs, count) + 1)).astype(int)
        return [slice(a, b) for a, b in itertools.pairwise(bounds.tolist())]

    def columns(self, count: int) -> np.ndarray:
        """Return the columns of about ``count`` equally spaced frames in each window."""
        stride = max(1, int((self.weight > 0).sum(axis=1).min()) // count)
        return np.arange((stride - 1) // 2, self.frames.shape[1], stride)

    def sampled(self, columns: np.ndarray) -> WindowRows:
        """Select the frames in ``columns``, and increase their weights so that they represent the whole window."""
        weight = self.weight[:, columns]
        weight = weight * (self.weight.sum(axis=1) / weight.sum(axis=1))[:, None]
        return WindowRows(self.frames[:, columns], self.time[:, columns], weight)


class Interpolant(Protocol):
    """Points interpolated between keyframes, and their derivatives w.r.t. the keyframes."""

    @property
    def value(self) -> Array:
        """(W, n, d) interpolated points."""
        ...

    def vjp(self, cotangent: Array) -> Array:
        """Convert derivatives (W, n, d) w.r.t. points to derivatives (W, n, k, d) w.r.t. each keyframe."""
        ...

    def jacobian(self, key: int) -> Array:
        """Return the derivatives (W, n, d, d) of the points w.r.t. one keyframe."""
        ...


def lagrange(time: Array, num_keys: int = 3) -> Array:
    """Return the weights (..., k) of k equally spaced keyframes in the polynomial through them.

    With three keyframes, the cubic in thesis eq. 6.10 is underdetermined. The parabola is used, because it has the
    least curvature.
    """
    xp = array_namespace(time)
    if num_keys == 2:
        return xp.stack([1 - time, time], axis=-1)
    if num_keys == 3:
        return xp.stack([(1 - time) * (1 - 2 * time), 4 * time * (1 - time), time * (2 * time - 1)], axis=-1)
    at, keys = time * (num_keys - 1), range(num_keys)
    factors = [[(at - j) / (i - j) for j in keys if j != i] for i in keys]
    return xp.stack([reduce(mul, others) for others in factors], axis=-1)


def rows_of(values: Array) -> Array:
    """Reshape values by window and frame (W, n, ...) to values by frame (W·n, ...)."""
    return array_namespace(values).reshape(values, (-1, *values.shape[2:]))


def combined(weights: Array, values: Array) -> Array:
    """Return the weighted sums (W·n, d) of the keyframes' values: ``Σ_k w_k x_k``."""
    if weights.shape[1] > 1:
        return rows_of(array_namespace(values).matmul(weights, values))
    # Sum single frames key by key, so that the order in which a BLAS adds three numbers does not matter.
    return sum(weights[:, 0, k, None] * values[:, k] for k in range(values.shape[1]))


def shared(weights: Array, by_frames: Array) -> Array:
    """Convert derivatives w.r.t. frames to derivatives (W, k, d) w.r.t. keyframes, with weights (W, n, k)."""
    xp = array_namespace(by_frames)
    rows = xp.reshape(by_frames, (*weights.shape[:2], -1))
    return xp.matmul(xp.matrix_transpose(weights), rows)


_STEPS = 60  # Largest number of conjugate-gradient steps. Chosen by hand.
_TOLERANCE = 1e-10  # Relative residual at which the iteration ends. Chosen by hand.


def control_points(keys: Keyframes, layout: KeyframeLayout) -> Keyframes:
    """Return control points of the spline closest to the parabolas through the keyframes.

    The points are ``argmin_c Σ_f |Σ_k B_k(f) c_k - Σ_k w_k(f) x_k|²`` over the frames f, with cubic B-splines B (see
    ``KeyframeLayout.spline_shares``) and Lagrange weights w. Neighbouring keyframes are close to each other, so codes
    and quaternions are treated as points in flat space. Points on the spline are normalised later.
    """
    given = [to_numpy(part) for part in (keys.z, keys.quat, keys.transl, keys.residual)]
    flat = np.concatenate([part.reshape(len(part), -1) for part in given], axis=1)
    found = _spline(flat, layout)[0]
    ends = np.cumsum([part[0].size for part in given])
    parts = [part.reshape(like.shape) for part, like in zip(np.split(found, ends[:-1], axis=1), given, strict=True)]
    return Keyframes(*(constant(part, keys.z) for part in parts))


def spline_states(keys: np.ndarray, layout: KeyframeLayout) -> np.ndarray:
    """Interpolate keyframe values (K, d) in flat space to all frames (F, d), with the spline of ``control_points``."""
    points, rows, shares = _spline(keys, layout)
    padded = np.pad(points, ((1, 1), (0, 0)))
    fives = np.stack([padded[i : len(padded) - 4 + i : 2] for i in range(5)], axis=1)
    states = (shares @ fives).reshape(-1, keys.shape[1])
    return states[rows.weight.reshape(-1) > 0]


def _spline(flat: np.ndarray, layout: KeyframeLayout) -> tuple[np.ndarray, WindowRows, np.ndarray]:
    rows = layout.rows()
    shares = layout.spline_shares(np.arange(layout.num_windows)[:, None] + 0 * rows.frames, rows.time)
    return _nearest(flat, rows, shares), rows, shares


def _nearest(flat: np.ndarray, rows: WindowRows, shares: np.ndarray) -> np.ndarray:
    """Compute the control points (K, d) by conjugate gradients (Hestenes and Stiefel 1952).

    If keyframes are denser than frames, undetermined directions keep the values of the keyframes.
    """
    weighted_T = np.swapaxes(shares * (rows.weight > 0)[..., None], 1, 2)
    normal = weighted_T @ shares
    triples = np.stack([flat[i : len(flat) - 2 + i : 2] for i in range(3)], axis=1)
    x = np.pad(flat, ((1, 1), (0, 0)))
    error = _summed(weighted_T @ (lagrange(rows.time) @ triples)) - _applied(normal, x)
    direction, square = error, (error * error).sum(axis=0)
    enough = _TOLERANCE**2 * np.maximum(square, 1e-30)
    for _ in range(_STEPS):
        going = square > enough
        if not going.any():
            break
        along = _applied(normal, direction)
        step = np.where(going, square / np.maximum((direction * along).sum(axis=0), 1e-300), 0.0)
        x, error = x + step * direction, error - step * along
        former, square = square, (error * error).sum(axis=0)
        direction = error + square / np.maximum(former, 1e-300) * direction
    return x[1:-1]


def _applied(normal: np.ndarray, x: np.ndarray) -> np.ndarray:
    fives = np.stack([x[i : len(x) - 4 + i : 2] for i in range(5)], axis=1)
    return _summed(normal @ fives)


def _summed(by_keys: np.ndarray) -> np.ndarray:
    count = len(by_keys)
    summed = np.zeros((2 * count + 3, by_keys.shape[-1]))
    for k in range(5):
        summed[k : k + 2 * count - 1 : 2] += by_keys[:, k]
    return summed
