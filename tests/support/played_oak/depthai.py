"""``import depthai`` for programs of tests: an OAK that gives 30 pictures a second and never ends."""

from __future__ import annotations

import io
import time
from functools import cache
from importlib import import_module
from typing import Any

import numpy as np

from tests.support.fake_depthai import FakeDepthai, Picture, Queue

RATE_HZ = 30.0
SHAPE = (400, 640)
__version__ = FakeDepthai.__version__


class _Endless(Queue):
    """Gives the next picture once its time has come."""

    def __init__(self, module: Any) -> None:
        super().__init__(module, [])
        self._begin, self._number = time.monotonic(), 0

    def tryGet(self) -> Any:
        seconds = self._number / RATE_HZ
        if time.monotonic() - self._begin < seconds:
            return None
        number, self._number = self._number, self._number + 1
        if any(name.startswith("VideoEncoder") for name, _, _ in self.module.kept):
            return Picture(_jpeg(), 100.0 + seconds, number)
        infrared, depth = np.full(SHAPE, 20, np.uint8), np.full(SHAPE, 2000, np.uint16)
        return {name: Picture(values, 100.0 + seconds, number) for name, values in
                (("infrared", infrared), ("depth", depth))}  # fmt: skip


@cache
def _jpeg() -> bytes:
    av: Any = import_module("av")

    out = io.BytesIO()
    with av.open(out, "w", format="mjpeg") as container:
        stream = container.add_stream("mjpeg", rate=30)
        stream.width, stream.height, stream.pix_fmt = 1920, 1080, "yuvj420p"
        picture = av.VideoFrame.from_ndarray(np.zeros((1080, 1920, 3), np.uint8), format="rgb24")
        for packet in [*stream.encode(picture), *stream.encode(None)]:
            container.mux(packet)
    return out.getvalue()


class _Played(FakeDepthai):
    def __init__(self) -> None:
        super().__init__([], ends=False)
        FakeDepthai.queue = _Endless(self)


_MODULE = _Played()


def __getattr__(name: str) -> Any:
    return getattr(_MODULE, name)
