"""Where a person is looked at: an upright square about the hips, from MediaPipe's person detector or the last points.

Bazarevsky et al. 2020, BlazePose: boxes by anchors, aligned by the middle of the hips and the circle around the body.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

DETECTOR_SIDE = 224
"""Pixels of the person detector's input."""
_GRIDS = ((28, 2), (14, 2), (7, 6))
"""Cells a side of each grid of anchors, and anchors a cell."""
NUM_ANCHORS = sum(cells * cells * anchors for cells, anchors in _GRIDS)
NUM_NUMBERS = 12
"""Of a box: middle, size, and four points, of which the first two are the hips and the top of the circle."""
_LIKELY = 0.5
"""Score from which an anchor shows a person."""
_SAME = 0.3
"""Overlap (intersection over union) from which two boxes are of one person."""
_GROWN = 1.25
"""Times the circle's diameter that a square is long."""


@dataclass(frozen=True)
class PersonBox:
    """``x_picture = A x_crop + b`` for pixels of a square crop."""

    A: np.ndarray
    """(2, 2)."""
    b: np.ndarray
    """(2,) px."""

    def cut(self, rgb: np.ndarray, side: int, *, black: bool) -> np.ndarray:
        """Return the (side, side, 3) float32 crop, 0 to 1, bilinear. Beyond the picture it is black, or as its edge."""
        high, wide = rgb.shape[:2]
        step = np.arange(side, dtype=np.float32)
        (ax, bx), (ay, by) = self.A.astype(np.float32)
        x = ax * step + bx * step[:, None] + np.float32(self.b[0])
        y = ay * step + by * step[:, None] + np.float32(self.b[1])
        outside = (x < -0.5) | (x > wide - 0.5) | (y < -0.5) | (y > high - 0.5)
        x, y = np.clip(x, 0, wide - 1), np.clip(y, 0, high - 1)
        left, top = np.minimum(x.astype(np.int32), wide - 2), np.minimum(y.astype(np.int32), high - 2)
        u, v = (x - left.astype(np.float32))[..., None], (y - top.astype(np.float32))[..., None]
        pixels, first = np.ascontiguousarray(rgb).reshape(-1, 3), top * wide + left
        a, b, c, d = (pixels.take(first + o, axis=0).astype(np.float32) for o in (0, 1, wide, wide + 1))
        upper, lower = a + u * (b - a), c + u * (d - c)
        picture = upper + v * (lower - upper)
        if black:
            picture[outside] = 0.0
        return picture / np.float32(255.0)

    def in_picture(self, points: np.ndarray) -> np.ndarray:
        """Return (K, 2) px of the picture from (K, 2) of the crop."""
        return points @ self.A.T + self.b


def whole_picture(rgb: np.ndarray) -> PersonBox:
    """Return the square that holds a whole picture, for the person detector."""
    length = float(max(rgb.shape[:2]))
    middle = 0.5 * np.array(rgb.shape[1::-1], np.float64)
    return _square(middle, np.array([0.0, -1.0]), length, DETECTOR_SIDE)


def aligned(hips: np.ndarray, top: np.ndarray, side: int) -> PersonBox:
    """Return the square about the hips whose up direction leads to the top of the circle.

    Args:
        hips: (2,) px.
        top: (2,) px, on the circle around the body.
    """
    along = top - hips
    radius = float(np.hypot(*along))
    up = along / radius if radius > 1e-6 else np.array([0.0, -1.0])
    return _square(hips, up, _GROWN * 2.0 * max(radius, 4.0), side)


def found_people(boxes: np.ndarray, scores: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return hips and top (2,) of each person in the detector's input, pixels, the likeliest first.

    Overlapping boxes are one person's: their points are averaged by score.

    Args:
        boxes: (NUM_ANCHORS, 12) as the model gives them.
        scores: (NUM_ANCHORS,) before the logistic function.
    """
    score = 1.0 / (1.0 + np.exp(-np.clip(scores, -100.0, 100.0)))
    likely = np.flatnonzero(score >= _LIKELY)
    likely = likely[np.argsort(-score[likely], kind="stable")]
    numbers = boxes[likely].reshape(-1, NUM_NUMBERS // 2, 2).astype(np.float64)
    places = DETECTOR_SIDE * _ANCHORS[likely, None] + numbers
    low, high = places[:, 0] - 0.5 * numbers[:, 1], places[:, 0] + 0.5 * numbers[:, 1]
    people, left = [], np.ones(len(likely), bool)
    for k in range(len(likely)):
        if left[k]:
            same = left & (_overlap(low[k], high[k], low, high) > _SAME)
            same[k] = True
            left &= ~same
            weight = score[likely[same], None, None]
            hips, top = (weight * places[same, 2:4]).sum(axis=0) / weight.sum()
            people.append((hips, top))
    return people


def _square(middle: np.ndarray, up: np.ndarray, length: float, side: int) -> PersonBox:
    right = np.array([-up[1], up[0]])
    A = np.stack([right, -up], axis=1) * (length / side)
    return PersonBox(A, middle - A @ np.full(2, 0.5 * side))


def _overlap(low: np.ndarray, high: np.ndarray, lows: np.ndarray, highs: np.ndarray) -> np.ndarray:
    shared = np.prod(np.maximum(np.minimum(high, highs) - np.maximum(low, lows), 0.0), axis=-1)
    own, others = np.prod(high - low), np.prod(highs - lows, axis=-1)
    return shared / np.maximum(own + others - shared, 1e-9)


def _anchors() -> np.ndarray:
    """Return the (NUM_ANCHORS, 2) middles of all anchors, shares of the input."""
    grids = []
    for cells, anchors in _GRIDS:
        y, x = np.mgrid[0:cells, 0:cells]
        grids.append(np.repeat((np.stack([x, y], axis=-1).reshape(-1, 2) + 0.5) / cells, anchors, axis=0))
    return np.concatenate(grids)


_ANCHORS = _anchors()
