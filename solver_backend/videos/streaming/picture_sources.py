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
    """A picture of one camera. Its pixels are made only if they are asked for."""

    number: int
    """Count of the camera's pictures, from 0."""
    time_s: float
    """Seconds on the clock that all cameras share."""
    arrived: float
    """``time.perf_counter()`` when it came, or when a replay lets it come."""
    rgb: Callable[[], np.ndarray]
    """Returns (H, W, 3) uint8."""


class PictureSource(Protocol):
    """A camera, or a video in the place of one."""

    name: str
    size: tuple[int, int]
    """Width and height, px. Known once it is open."""
    fps: float
    """Pictures per second. Known once it is open."""

    def open(self) -> None:
        """Connect, so that no picture has to wait for it.

        Raises:
            MocapError: it is not there.
        """
        ...

    def pictures(self, start: float) -> Iterator[LivePicture]:
        """Yield pictures as they come, until the camera ends.

        Args:
            start: ``time.perf_counter()`` at which the shared clock is 0.
        """
        ...

    def close(self) -> None:
        """End. May be called several times, and from another thread."""
        ...


SIZE, FPS = (1280, 720), 30.0
"""Requested size and rate of a webcam, which may give another size."""
_FORMATS = {"linux": ("v4l2", "/dev/video{}"), "darwin": ("avfoundation", "{}"), "win32": ("dshow", "video={}")}
"""FFmpeg's name of each system's cameras, and how one is named."""


class Webcam:
    """A camera by its number. Pictures have the times at which they come."""

    def __init__(self, name: str, index: int) -> None:
        self.name, self.index = name, index
        self.size, self.fps = SIZE, FPS
        self._next: Callable[[], Callable[[], np.ndarray] | None] | None = None
        self._close: Callable[[], Any] = lambda: None

    def open(self) -> None:
        """Connect.

        Raises:
            VideoUnreadable: there is no such camera.
        """
        try:
            import cv2
        except ModuleNotFoundError:
            self._open_by_av()
            return
        camera = cv2.VideoCapture(self.index)
        if not camera.isOpened():
            raise _missing(self.index)
        for key, value in (
            (cv2.CAP_PROP_FRAME_WIDTH, SIZE[0]),
            (cv2.CAP_PROP_FRAME_HEIGHT, SIZE[1]),
            (cv2.CAP_PROP_FPS, FPS),
        ):
            camera.set(key, value)
        width, height = (int(camera.get(key)) for key in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
        self.size, self.fps = (width, height), float(camera.get(cv2.CAP_PROP_FPS)) or FPS

        def read() -> Callable[[], np.ndarray] | None:
            there, bgr = camera.read()
            return partial(_from_bgr, bgr) if there else None

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
        """Let the camera go."""
        self._next = None
        self._close()


def _from_bgr(bgr: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(bgr[..., ::-1])


def _missing(index: int) -> VideoUnreadable:
    return VideoUnreadable(
        "The webcam cannot be opened.",
        where=f"webcam:{index}",
        hint="Check that it is plugged in, its number, and that no other program uses it.",
    )


class ReplayedVideo:
    """A video file, played once or again and again."""

    def __init__(self, name: str, path: Path, *, repeat: bool = False) -> None:
        self.name, self.path = name, path
        self.size, self.fps = (0, 0), 0.0
        self._repeat, self._closed = repeat, threading.Event()

    def open(self) -> None:
        """Read what the video is."""
        info = probe(self.path)
        self.size, self.fps, self._first_s = info.size, info.fps, float(info.times_s[0])
        self._length_s = float(info.times_s[-1] - info.times_s[0]) + 1.0 / max(info.fps, 1.0)

    def pictures(self, start: float) -> Iterator[LivePicture]:
        """Yield each picture when it is due. One that is decoded late comes late."""
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
