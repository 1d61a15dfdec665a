"""Exchange messages with a detector process. A message is a line of JSON, followed by the bytes of arrays.

The process writes ``{"ready": {...}}`` with its description, or ``{"error": {"code", "message", "hint"}}``. For every
image it receives ``{"shape": [h, w, 3], "time_s": t}`` and h·w·3 bytes. It answers with ``{"arrays": {name: shape}}``,
followed by the arrays as float32 in that order. It exits when its input ends.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable
from typing import Any, BinaryIO, Protocol

import numpy as np

THREADS = int(os.environ.get("POSE_WORKER_THREADS", "1"))  # Number of threads per model, see ``DetectorProcess``.


class Refused(Exception):
    """A detector cannot run. The error contains a code, a message and a hint."""

    def __init__(self, code: str, message: str, hint: str = "") -> None:
        super().__init__(message)
        self.code, self.message, self.hint = code, message, hint


class PoseDetector(Protocol):
    """Interface of the detectors in this package."""

    about: dict[str, Any]
    """``name`` including its version, ``joint_set`` or ``num_keypoints``, and the maximum number of ``people``."""

    def detect(self, rgb: np.ndarray, time_s: float) -> dict[str, np.ndarray]:
        """Detect ``keypoints`` (P, K, 3) in an image: x and y in pixels, and confidence 0 to 1.

        Some detectors also return ``hands`` (P, 2, 21, 3), left hand first, with NaN for undetected hands.
        """
        ...


def serve(make: Callable[[dict[str, Any]], PoseDetector]) -> int:
    """Answer requests on standard input until it ends. Return the exit code.

    The output of libraries is redirected to standard error.
    """
    pictures, answers = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    try:
        detector = make(json.loads(sys.argv[1]) if len(sys.argv) > 1 else {})
    except Refused as error:
        _say(answers, {"error": {"code": error.code, "message": error.message, "hint": error.hint}})
        return 1
    _say(answers, {"ready": detector.about})
    while line := pictures.readline():
        head = json.loads(line)
        shape = tuple(head["shape"])
        rgb = np.frombuffer(_exactly(pictures, int(np.prod(shape))), np.uint8).reshape(shape)
        found = {name: np.ascontiguousarray(a, np.float32) for name, a in detector.detect(rgb, head["time_s"]).items()}
        _say(answers, {"arrays": {name: array.shape for name, array in found.items()}}, *found.values())
    return 0


def _say(stream: BinaryIO, head: dict[str, Any], *arrays: np.ndarray) -> None:
    stream.write(json.dumps(head).encode() + b"\n")
    for array in arrays:
        stream.write(array.tobytes())
    stream.flush()


def _exactly(stream: BinaryIO, count: int) -> bytes:
    data = stream.read(count)
    if len(data) < count:
        raise SystemExit(0)  # the process that reads the answers has ended
    return data
