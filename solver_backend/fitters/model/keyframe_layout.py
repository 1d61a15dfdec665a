"""Where keyframes stand in time, and the frames of their windows (thesis 6.2.5)."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class KeyframeLayout:
    """N windows over F frames; window w uses the keys n w, ..., n w + n, its neighbours share the end keys.

    The whole-take method, its terms over keys and its splines are for n = 2.
    """

    bounds: np.ndarray
    """(N + 1,) frame numbers at which windows meet, rising; the first and the last are the ends of the frames."""
    free: int = 2
    """n, the keys that a window adds: of SIDER-n."""

    @classmethod
    def even(cls, num_frames: int, window: int, first: int = 0, free: int = 2) -> KeyframeLayout:
        """Cut F >= 2 frames from ``first`` on into windows of nearly ``window`` frames."""
        count = max(1, round((num_frames - 1) / window))
        return cls(first + np.round(np.linspace(0, num_frames - 1, count + 1)).astype(np.int64), free)

    @property
    def num_windows(self) -> int:
        """Number of windows N."""
        return len(self.bounds) - 1

    @property
    def num_keys(self) -> int:
        """Number of keys, n N + 1."""
        return self.free * self.num_windows + 1

    @property
    def key_times(self) -> np.ndarray:
        """(n N + 1,) frame number of each key; one within a window may fall between two frames."""
        times = np.empty(self.num_keys)
        times[:: self.free] = self.bounds
        for key in range(1, self.free):
            share = key / self.free
            times[key :: self.free] = (1 - share) * self.bounds[:-1] + share * self.bounds[1:]
        return times

    @property
    def frames(self) -> np.ndarray:
        """(F,) numbers of the frames from the first bound to the last."""
        return np.arange(self.bounds[0], self.bounds[-1] + 1)

    def positions(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return window and position in it, 0..1, of frame numbers; a bound belongs to the earlier window."""
        window = np.clip(np.searchsorted(self.bounds, times, side="left") - 1, 0, self.num_windows - 1)
        return window, (times - self.bounds[window]) / np.diff(self.bounds)[window]

    def spline_shares(self, window: np.ndarray, time: np.ndarray) -> np.ndarray:
        """Return (..., 5) weights of the control points 2w - 1 .. 2w + 3 on the spline at places of the same shape.

        ``Σ_k B_k(t) c_k`` with the cubic B-splines whose knots are the keys' times: velocity and acceleration are
        continuous. Beyond both ends stands a point more, ``3 c_0 - 3 c_1 + c_2``, so that as many points are free as
        there are keys.

        Reference: de Boor 1972, "On calculating with B-splines".
        """
        late = (time >= 0.5).astype(int)
        key, u, last = 2 * window + late, 2.0 * time - late, self.num_keys - 1
        steps = np.diff(self.key_times)
        knots = np.concatenate([[steps[0]] * 3, steps, [steps[-1]] * 3]).cumsum()
        knots = np.concatenate([[0.0], knots])  # the key k stands at 3 + k
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
        """Return every ``stride``-th frame of each window, each frame standing for the ones left out."""
        first, last = self.bounds[:-1] + 1, self.bounds[1:]
        first[0] -= 1
        width = int((last - first).max()) // stride + 1
        frames = first[:, None] + stride * np.arange(width)
        inside = frames <= last[:, None]
        frames = np.where(inside, frames, last[:, None])
        time = (frames - self.bounds[:-1, None]) / np.diff(self.bounds)[:, None]
        return WindowRows(frames, time, float(stride) * inside)

    def gaps(self, seen: np.ndarray) -> np.ndarray:
        """Return (2N,) bool: none of the frames from one key to the next is ``seen``, (F,) of the whole take."""
        before = np.concatenate([[0], np.cumsum(seen)])
        times = self.key_times
        first, last = np.ceil(times[:-1]).astype(int), np.floor(times[1:]).astype(int)
        return before[last + 1] == before[first]

    def part(self, windows: slice) -> KeyframeLayout:
        """Return the layout of some windows."""
        return KeyframeLayout(self.bounds[windows.start : windows.stop + 1], self.free)


@dataclass(frozen=True)
class WindowRows:
    """Frames laid out window by window: N rows of n frames, the shorter rows padded with frames of no weight."""

    frames: np.ndarray
    """(N, n) frame numbers."""
    time: np.ndarray
    """(N, n) positions in the window, 0..1."""
    weight: np.ndarray
    """(N, n) how many frames each one stands for; 0 in the padding."""

    def blocks(self, num_frames: int) -> list[slice]:
        """Return ranges of windows, alike in length, even in number, with ``num_frames`` frames each at most."""
        count, width = self.frames.shape
        pairs = -(-count * width // (2 * num_frames))
        bounds = np.round(np.linspace(0, count, min(2 * pairs, count) + 1)).astype(int)
        return [slice(a, b) for a, b in itertools.pairwise(bounds.tolist())]

    def columns(self, count: int) -> np.ndarray:
        """Return about ``count`` columns spread over the rows; more where the shortest row would have fewer."""
        stride = max(1, int((self.weight > 0).sum(axis=1).min()) // count)
        return np.arange((stride - 1) // 2, self.frames.shape[1], stride)

    def sampled(self, columns: np.ndarray) -> WindowRows:
        """Return the frames of these columns, standing for those of the others."""
        weight = self.weight[:, columns]
        weight = weight * (self.weight.sum(axis=1) / weight.sum(axis=1))[:, None]
        return WindowRows(self.frames[:, columns], self.time[:, columns], weight)

    def select(self, windows: slice) -> WindowRows:
        """Return the rows of these windows."""
        return WindowRows(self.frames[windows], self.time[windows], self.weight[windows])
