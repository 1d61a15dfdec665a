"""A video in the place of a camera: its pictures come at their own times."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path

from solver_backend.videos.files.probe import probe
from solver_backend.videos.files.read import decoded_frames, picture_of
from solver_backend.videos.streaming.pictures import LivePicture


class ReplayedVideo:
    """A video file, played once or again and again."""

    def __init__(self, name: str, path: Path, *, repeat: bool = False) -> None:
        self.name, self.path = name, path
        self.size, self.fps = (0, 0), 0.0
        self._repeat, self._closed = repeat, threading.Event()

    def open(self) -> None:
        """Read what the video is.

        Raises:
            BackendMissing, VideoUnreadable: see ``probe``.
        """
        info = probe(self.path)
        self.size, self.fps, self._first_s = info.size, info.fps, float(info.times_s[0])
        self._length_s = float(info.times_s[-1] - info.times_s[0]) + 1.0 / max(info.fps, 1.0)

    def pictures(self, start: float) -> Iterator[LivePicture]:
        """Yield each picture when it is due; one that is decoded late comes late."""
        number, late_s = 0, 0.0
        while not self._closed.is_set():
            for frame in decoded_frames(self.path):
                at = float(frame.time) - self._first_s + late_s
                self._closed.wait(max(start + at - time.perf_counter(), 0.0))
                if self._closed.is_set():
                    return
                yield LivePicture(number, at, start + at, partial(picture_of, frame))
                number += 1
            if not self._repeat:
                return
            late_s += self._length_s

    def close(self) -> None:
        """End the replay."""
        self._closed.set()
