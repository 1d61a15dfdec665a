"""Cameras and detectors in the place of real ones: known keypoints, found after known delays."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.types import Capture
from solver_backend.videos.streaming.moments import LivePicture

SIZE = (16, 8)


@dataclass
class FakeCamera:
    """A camera whose pictures are black but for their number."""

    name: str
    fps: float = 30.0
    frames: int = 60
    failure: Exception | None = None
    """Raised after the last picture."""
    size: tuple[int, int] = SIZE
    closed: threading.Event = field(default_factory=threading.Event)

    def open(self) -> None:
        """Do nothing."""

    def pictures(self, start: float) -> Iterator[LivePicture]:
        """Yield pictures at their times."""
        for number in range(self.frames):
            at = number / self.fps
            if self.closed.wait(max(start + at - time.perf_counter(), 0.0)):
                return
            yield LivePicture(number, at, start + at, lambda number=number: _numbered(number))
        if self.failure is not None:
            raise self.failure

    def close(self) -> None:
        """End."""
        self.closed.set()


@dataclass
class FakeDetector:
    """Finds the known keypoints of one view's pictures, each after a delay."""

    keypoints: np.ndarray
    """(F, K, 3) px and confidence."""
    delay_s: float = 0.0
    one_at_a_time: Any = field(default_factory=nullcontext)
    """A lock that detectors share, as if there were one core."""
    joint_set: str = "BODY_25"
    failure: Exception | None = None
    fails_at: int = 1 << 30
    """Picture at which it breaks."""

    @property
    def about(self) -> dict[str, Any]:
        """Say what it is."""
        return {"name": "fake", "joint_set": self.joint_set}

    def __enter__(self) -> FakeDetector:
        return self

    def __exit__(self, *_: object) -> None:
        return

    def detect(self, rgb: np.ndarray, time_s: float) -> dict[str, np.ndarray]:
        """Return what is known of a picture."""
        number = int(rgb[0, 0, 0]) + 256 * int(rgb[0, 0, 1])
        if number >= self.fails_at and self.failure is not None:
            raise self.failure
        with self.one_at_a_time:
            time.sleep(self.delay_s)
        return {"keypoints": self.keypoints[None, min(number, len(self.keypoints) - 1)]}


def _numbered(number: int) -> np.ndarray:
    picture = np.zeros((SIZE[1], SIZE[0], 3), np.uint8)
    picture[0, 0, :2] = number % 256, number // 256
    return picture


def demo_views(views: list[int]) -> Capture:
    """Return the demo's capture of some of its cameras: noisy detections, and the truth."""
    capture = demo_capture()
    assert capture.cameras is not None and capture.keypoints is not None
    c, found = capture.cameras, capture.keypoints
    cameras = c.subset(views)
    keypoints = replace(found, xy=found.xy[views], confidence=found.confidence[views])
    return replace(capture, cameras=cameras, keypoints=keypoints, footage=())


def seen_by(capture: Capture, view: int) -> np.ndarray:
    """Return the (F, K, 3) detections of a view, as a detector returns them."""
    assert capture.keypoints is not None
    found = capture.keypoints
    return np.concatenate([found.xy[view], found.confidence[view, ..., None]], axis=-1).astype(np.float64)
