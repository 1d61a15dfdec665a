"""Read pictures of live cameras: webcams, and videos played at their own rate."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from solver_backend.exchange.errors import BackendMissing
from solver_backend.videos.files.video import VideoUnreadable, decoded_frames, library, picture_of, probe


@dataclass(frozen=True)
class LivePicture:
    """A picture of one camera, decoded on demand."""

    number: int
    """Index of the picture."""
    time_s: float
    """Seconds on the clock that all cameras share."""
    arrived: float
    """``time.perf_counter()`` when it arrived, or when a replay is due."""
    rgb: Callable[[], np.ndarray]
    """Returns (H, W, 3) uint8."""


class PictureSource(Protocol):
    """A camera, or a video that replaces one."""

    name: str
    size: tuple[int, int]
    """Width and height in pixels, known once it is open."""
    fps: float
    """Pictures per second, known once it is open."""

    def open(self) -> None:
        """Connect. Raise ``MocapError`` if it is missing."""
        ...

    def pictures(self, start: float) -> Iterator[LivePicture]:
        """Yield pictures as they come until the end. The shared clock is 0 at ``start`` (``time.perf_counter()``)."""
        ...

    def close(self) -> None:
        """Stop. May be called several times, and from another thread."""
        ...


SIZE, FPS = (1280, 720), 30.0
"""Requested size and rate of a webcam, which may differ."""
_FORMATS = {"linux": ("v4l2", "/dev/video{}"), "darwin": ("avfoundation", "{}"), "win32": ("dshow", "video={}")}
"""FFmpeg's input format and device name on each system."""


class Webcam:
    """A camera by its number. Pictures have the times at which they arrive."""

    def __init__(self, name: str, index: int) -> None:
        self.name, self.index = name, index
        self.size, self.fps = SIZE, FPS
        self._next: Callable[[], Callable[[], np.ndarray] | None] | None = None
        self._close: Callable[[], Any] = lambda: None

    def open(self) -> None:
        """Connect. Raise ``VideoUnreadable`` if there is no such camera."""
        try:
            import cv2
        except ModuleNotFoundError:
            self._open_by_av()
            return
        camera = cv2.VideoCapture(self.index)
        if not camera.isOpened():
            raise _missing(self.index)
        wide, high, rate = cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT, cv2.CAP_PROP_FPS
        for key, value in ((wide, SIZE[0]), (high, SIZE[1]), (rate, FPS)):
            camera.set(key, value)
        self.size, self.fps = (int(camera.get(wide)), int(camera.get(high))), float(camera.get(rate)) or FPS

        def read() -> Callable[[], np.ndarray] | None:
            there, bgr = camera.read()
            return partial(np.ascontiguousarray, bgr[..., ::-1]) if there else None

        self._next, self._close = read, camera.release

    def _open_by_av(self) -> None:
        try:
            av = library()
        except BackendMissing as error:
            hint = "Install it with: pip install av."
            raise BackendMissing("A webcam needs OpenCV or PyAV, and neither is installed.", hint=hint) from error
        kind, name = _FORMATS.get(sys.platform, _FORMATS["linux"])
        options = {"video_size": f"{SIZE[0]}x{SIZE[1]}", "framerate": f"{FPS:g}"}
        try:
            container = av.open(name.format(self.index), format=kind, options=options)
        except (av.error.FFmpegError, OSError, ValueError) as error:
            raise _missing(self.index) from error
        stream = container.streams.video[0]
        self.size = (stream.codec_context.width, stream.codec_context.height)
        frames = container.decode(stream)

        def read() -> Callable[[], np.ndarray] | None:
            try:
                frame = next(frames, None)
            except (av.error.FFmpegError, OSError):
                return None
            return None if frame is None else partial(frame.to_ndarray, format="rgb24")

        self._next, self._close = read, container.close

    def pictures(self, start: float) -> Iterator[LivePicture]:
        """Yield pictures as they come, until the camera is unplugged."""
        number = 0
        while self._next is not None and (rgb := self._next()) is not None:
            arrived = time.perf_counter()
            yield LivePicture(number, arrived - start, arrived, rgb)
            number += 1

    def close(self) -> None:
        """Release the camera."""
        self._next = None
        self._close()


def _missing(index: int) -> VideoUnreadable:
    hint = "Check that it is plugged in, its number, and that no other program uses it."
    return VideoUnreadable("The webcam cannot be opened.", where=f"webcam:{index}", hint=hint)


class ReplayedVideo:
    """A video file that is played once or repeatedly."""

    def __init__(self, name: str, path: Path, *, repeat: bool = False) -> None:
        self.name, self.path = name, path
        self.size, self.fps = (0, 0), 0.0
        self._repeat, self._closed = repeat, threading.Event()

    def open(self) -> None:
        """Read the properties of the video."""
        info = probe(self.path)
        self.size, self.fps, self._first_s = info.size, info.fps, float(info.times_s[0])
        self._length_s = float(info.times_s[-1] - info.times_s[0]) + 1.0 / max(info.fps, 1.0)

    def pictures(self, start: float) -> Iterator[LivePicture]:
        """Yield each picture when it is due, or late if it is decoded late."""
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
