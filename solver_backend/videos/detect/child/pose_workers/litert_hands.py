"""MediaPipe's hand landmark model run by Google's LiteRT: 21 points of the hand in a given crop."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

from .litert_model import LICENCE, LiteRtModel
from .serve import serve

MODELS = {
    "8c026882c9ec059ce0f8e75266bee5a9a23c341a40e0000df755374d3d1b9b68": "hand_landmark_full",
    "d7fde8ac11f8ce03f8663775bfc323f4fc9f2a38062b4f4efa142874ef5b2a48": "hand_landmark_lite",
}
"""SHA-256 of the models that are known."""
_PACKAGE = "@mediapipe/hands 0.4.1675469240"
_POINTS, _PRESENCE, _RIGHT = 63, 1, 1


class LiteRtHands:
    """Find the points of a hand."""

    def __init__(self, options: dict[str, Any]) -> None:
        self._model = LiteRtModel(Path(options["model"]), MODELS, _PACKAGE, int(options.get("threads", 1)))
        self._model.require_outputs([_POINTS, _PRESENCE, _RIGHT])
        self.about = {"name": self._model.name, "licence": LICENCE, "num_keypoints": 21, "people": 1}

    def detect(self, rgb: np.ndarray, time_s: float) -> dict[str, np.ndarray]:
        """Return the ``points`` (21, 2) in a (224, 224, 3) crop, and the shares ``presence`` and ``right``."""
        points, presence, right, *_ = self._model.run(rgb.astype(np.float32) / 255.0)
        return {"points": points.reshape(21, 3)[:, :2], "presence": presence.reshape(1), "right": right.reshape(1)}


if __name__ == "__main__":
    sys.exit(serve(LiteRtHands))
