"""MediaPipe's hand landmark model run by Google's LiteRT: 21 points of the hand in a crop that somebody else placed."""

from __future__ import annotations

import hashlib
import sys
from pathlib import Path
from typing import Any

import numpy as np

from .serve import Refused, serve

SIDE = 224
"""Pixels of the model's input."""
MODELS = {
    "8c026882c9ec059ce0f8e75266bee5a9a23c341a40e0000df755374d3d1b9b68": "hand_landmark_full",
    "d7fde8ac11f8ce03f8663775bfc323f4fc9f2a38062b4f4efa142874ef5b2a48": "hand_landmark_lite",
}
"""SHA-256 of the models that are known: of the npm package @mediapipe/hands 0.4.1675469240, Apache-2.0."""
_POINTS, _PRESENCE = 63, 1


class LiteRtHands:
    """Runs the model by ``ai_edge_litert``."""

    def __init__(self, options: dict[str, Any]) -> None:
        path = Path(options["model"])
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        if digest not in MODELS:
            raise Refused(
                "detector_outputs_unknown",
                f"The model's SHA-256 is {digest}; it is none of {', '.join(MODELS.values())}.",
                "Take hand_landmark_full.tflite out of the npm package @mediapipe/hands 0.4.1675469240.",
            )
        try:
            from ai_edge_litert.interpreter import (  # pyright: ignore[reportMissingImports] - of its own environment
                Interpreter,
            )
        except ImportError as error:
            raise Refused(
                "detector_missing",
                f"This Python has no ai-edge-litert: {error} ({sys.executable})",
                "pip install ai-edge-litert numpy in an environment of its own, and name its Python with --python.",
            ) from error
        self._model = Interpreter(str(path), num_threads=int(options.get("threads", 1)))
        self._model.allocate_tensors()
        self._into = self._model.get_input_details()[0]["index"]
        outputs = self._model.get_output_details()
        widths = [int(np.prod(output["shape"])) for output in outputs]
        if widths[:2] != [_POINTS, _PRESENCE]:
            raise Refused(
                "detector_outputs_unknown", f"The model's outputs hold {widths} numbers; 63 and 1 are expected first."
            )
        self._points, self._presence = (output["index"] for output in outputs[:2])
        self.about = {"name": MODELS[digest], "licence": "Apache-2.0", "num_keypoints": 21, "people": 1}

    def detect(self, rgb: np.ndarray, time_s: float) -> dict[str, np.ndarray]:
        """Return the ``points`` (21, 2) of a crop (224, 224, 3), crop pixels, and their ``presence`` (1,), 0 to 1."""
        self._model.set_tensor(self._into, rgb[None].astype(np.float32) / 255.0)
        self._model.invoke()
        points = np.asarray(self._model.get_tensor(self._points)).reshape(21, 3)[:, :2]
        return {"points": points, "presence": np.asarray(self._model.get_tensor(self._presence)).reshape(1)}


if __name__ == "__main__":
    sys.exit(serve(LiteRtHands))
