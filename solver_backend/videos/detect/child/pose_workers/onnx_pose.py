"""Pose models in ONNX files, distinguished by their inputs and outputs: RTMPose, RTMO, YOLO-pose and MoveNet.

Picture models (RTMO, YOLO-pose, MoveNet) find people by themselves. RTMPose looks at one box at a time and follows the
people it has found from picture to picture, from the whole picture on.
"""

from __future__ import annotations

import os
import sys
from typing import Any

import numpy as np

from .onnx_models import KINDS, Model
from .serve import Refused, serve


class OnnxPose:
    """Runs a model by onnxruntime."""

    def __init__(self, options: dict[str, Any]) -> None:
        path = options["model"]
        try:
            import onnxruntime
        except ImportError as error:
            raise Refused(
                "detector_missing",
                f"This Python has no onnxruntime: {error} ({sys.executable})",
                "Install it with: pip install onnxruntime; or name another Python with --python.",
            ) from error
        settings = onnxruntime.SessionOptions()
        settings.intra_op_num_threads = int(options.get("threads", 1))
        settings.log_severity_level = 3
        try:
            session = onnxruntime.InferenceSession(path, settings, providers=["CPUExecutionProvider"])
        except Exception as error:  # onnxruntime's own kinds differ between its releases
            raise Refused(
                "detector_missing", f"The model cannot be loaded: {str(error).splitlines()[0]}", "Download it again."
            ) from error
        [given, *more] = session.get_inputs()
        outputs = session.get_outputs()
        shapes: list[tuple[str, list[Any]]] = [(o.name, list(o.shape)) for o in outputs]
        kind = None if more else next((k for k in KINDS if k.fits(list(given.shape), shapes)), None)
        if kind is None:
            raise Refused(
                "detector_outputs_unknown",
                f"Inputs {[i.shape for i in session.get_inputs()]} and outputs {shapes} are of no known kind.",
                "Export RTMPose (SimCC), RTMO, YOLO-pose or MoveNet to ONNX without further steps.",
            )

        def run(tensor: np.ndarray) -> list[np.ndarray]:
            return [np.asarray(value) for value in session.run(None, {given.name: tensor})]

        self._model: Model = kind(list(given.shape), given.type, shapes, run, int(options.get("people", 1)))
        self.about = {
            "name": f"{kind.label} {os.path.splitext(os.path.basename(path))[0]}",
            "num_keypoints": self._model.num_keypoints,
            "people": int(options.get("people", 1)),
        }

    def detect(self, rgb: np.ndarray, time_s: float) -> dict[str, np.ndarray]:
        """Return keypoints, see ``PoseDetector``."""
        return {"keypoints": self._model.people(rgb)}


if __name__ == "__main__":
    sys.exit(serve(OnnxPose))
