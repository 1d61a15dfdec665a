"""Run MediaPipe's pose model with 33 keypoints, or its holistic model with hands."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np

from .serve import Refused, serve

GREY = 127  # Grey level of painted boxes, half the range.
MARGIN = 0.15  # Margin around a person's painted box relative to its size. Painting over people reveals further ones.


class MediaPipePose:
    """Detects people with ``mediapipe.solutions``. Its smoothing is off, because it would delay fast movements."""

    def __init__(self, options: dict[str, Any]) -> None:
        try:
            import mediapipe  # MediaPipe is installed in a separate environment
        except ImportError as error:
            message = f"The MediaPipe package is missing: {error} ({sys.executable})"
            hint = "Press Set Up Detector in Blender's From Videos panel, or specify a Python with --python."
            raise Refused("detector_missing", message, hint) from error
        solutions = getattr(mediapipe, "solutions", None)
        if solutions is None:
            message = f"MediaPipe {mediapipe.__version__} does not include a pose model."
            hint = "Install mediapipe 0.10.21, as Set Up Detector in Blender's From Videos panel does."
            raise Refused("detector_missing", message, hint)
        self._hands = bool(options.get("hands"))
        kind = solutions.holistic.Holistic if self._hands else solutions.pose.Pose
        self._people = int(options.get("people", 1))
        settings = {"model_complexity": 1, "smooth_landmarks": False, "min_detection_confidence": 0.5}
        self._models = [kind(**settings) for _ in range(self._people)]
        name = f"mediapipe {mediapipe.__version__} pose full{' hands' * self._hands}"
        self.about = {"name": name, "joint_set": "MEDIAPIPE_33", "people": self._people}

    def detect(self, rgb: np.ndarray, time_s: float) -> dict[str, np.ndarray]:
        """Detect the keypoints and hands of all people (see ``PoseDetector``)."""
        bodies: list[np.ndarray] = []
        hands: list[np.ndarray] = []
        picture = rgb
        for number, model in enumerate(self._models):
            result = model.process(picture)
            if result.pose_landmarks is None:
                continue
            body = _pixels(result.pose_landmarks, rgb.shape, 33)
            bodies.append(body)
            if self._hands:
                both = (result.left_hand_landmarks, result.right_hand_landmarks)
                hands.append(np.stack([_pixels(hand, rgb.shape, 21) for hand in both]))
            if number + 1 < self._people:
                picture = _without(picture, body)
        found = {"keypoints": np.stack(bodies) if bodies else np.zeros((0, 33, 3))}
        if self._hands:
            found["hands"] = np.stack(hands) if hands else np.zeros((0, 2, 21, 3))
        return found


def _pixels(landmarks: Any | None, shape: Any, count: int) -> np.ndarray:
    """Convert landmarks to keypoints (K, 3). Points that the model places outside the image get confidence 0."""
    if landmarks is None:
        return np.full((count, 3), np.nan)
    points = np.array([(p.x, p.y, p.visibility if p.HasField("visibility") else 1.0) for p in landmarks.landmark])
    outside = ((points[:, :2] < 0) | (points[:, :2] > 1)).any(axis=1)
    points[:, :2] = points[:, :2] * (shape[1], shape[0]) - 0.5
    points[outside, 2] = 0.0
    return points


def _without(picture: np.ndarray, body: np.ndarray) -> np.ndarray:
    low, high = body[:, :2].min(axis=0), body[:, :2].max(axis=0)
    margin = MARGIN * (high - low)
    x, y = np.clip([low - margin, high + margin], 0, (picture.shape[1], picture.shape[0])).astype(int).T
    painted = picture.copy()
    painted[y[0] : y[1], x[0] : x[1]] = GREY
    return painted


if __name__ == "__main__":
    sys.exit(serve(MediaPipePose))
