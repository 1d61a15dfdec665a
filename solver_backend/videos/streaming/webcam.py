"""A webcam of this machine, by OpenCV where it is there, else by PyAV."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np

from solver_backend.exchange.errors import BackendMissing
from solver_backend.videos.files.container import library
from solver_backend.videos.files.errors import VideoUnreadable
from solver_backend.videos.streaming.pictures import LivePicture

SIZE, FPS = (1280, 720), 30.0
"""What is asked of a webcam; it may give another size."""
_FORMATS = {"linux": ("v4l2", "/dev/video{}"), "darwin": ("avfoundation", "{}"), "win32": ("dshow", "video={}")}
"""FFmpeg's name of each system's cameras, and how one is named."""


class Webcam:
    """A camera by its number; pictures have the times at which they come."""

    def __init__(self, name: str, index: int) -> None:
        self.name, self.index = name, index
        self.size, self.fps = SIZE, FPS
        self._next: Callable[[], Callable[[], np.ndarray] | None] | None = None
        self._close: Callable[[], Any] = lambda: None

    def open(self) -> None:
        """Connect.

        Raises:
            BackendMissing: neither OpenCV nor PyAV is installed.
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
            (cv2.CAP_PROP_FRAME_WIDTH, SIZE[0]), (cv2.CAP_PROP_FRAME_HEIGHT, SIZE[1]), (cv2.CAP_PROP_FPS, FPS),
        ):  # fmt: skip
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
        "The webcam cannot be opened.", where=f"webcam:{index}",
        hint="Check that it is plugged in, its number, and that no other program uses it.",
    )  # fmt: skip
