"""Bring your own detector: ``solver_backend detect VIDEOS --detector-worker own_detector.py --out CAPTURE.npz``.

It runs in its own process. ``--python`` selects the Python with your detector's packages. This example finds the
brightest pixels of a picture, so it runs anywhere. Replace it with your model.
"""

import sys
from typing import Any

import numpy as np
from pose_workers.serve import Refused, serve  # The program adds it to the path. It needs NumPy alone.

KEYPOINTS = 17
"""Keypoints in the order of COCO_17: nose, eyes, ears, shoulders, elbows, wrists, hips, knees, ankles."""


class Brightest:
    """Use the brightest pixels as keypoints, from top to bottom."""

    def __init__(self, options: dict[str, Any]) -> None:
        if options.get("hands"):
            raise Refused("detector_missing", "This detector finds no hands.", "Leave out --hands.")
        self.about = {"name": "brightest 1.0", "joint_set": "COCO_17", "people": 1}

    def detect(self, rgb: np.ndarray, time_s: float) -> dict[str, np.ndarray]:
        """Return (P, K, 3) people: x and y in pixels, (0, 0) at the top-left pixel's centre, and confidence 0 to 1."""
        brightness = rgb.astype(float).sum(axis=-1)
        rows, columns = np.unravel_index(np.argsort(brightness, axis=None)[-KEYPOINTS:], brightness.shape)
        order = np.argsort(rows)
        person = np.stack([columns[order], rows[order], np.full(KEYPOINTS, 0.5)], axis=-1)
        return {"keypoints": person[None].astype(np.float32)}


if __name__ == "__main__":
    sys.exit(serve(Brightest))
