"""Pictures written to a shot's folders by a thread, in bounded memory: ``kind/camera/000000.png``, or ``.exr``."""

from __future__ import annotations

from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from types import TracebackType

import numpy as np

from solver_backend.io.png import png_bytes
from solver_backend.synthesis.studio.writers.exr import exr_bytes

EXR = "exr"
"""Kind of pictures of floats: the normal as R, G, B and the depth as Z."""
_NOISY = ("infrared", "depth")
_WAITING = 16
"""Pictures that may wait to be written."""


class PictureWriter:
    """Writes pictures while others are made; packing them leaves Python's lock.

    Args:
        folder: the shot's.
        cameras: names of the views.
    """

    def __init__(self, folder: Path, cameras: tuple[str, ...]) -> None:
        self._folder, self._cameras = folder, cameras
        self._pool = ThreadPoolExecutor(1)
        self._waiting: deque[Future[int]] = deque()
        self.bytes = 0

    def __enter__(self) -> PictureWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            while self._waiting and error is None:
                self.bytes += self._waiting.popleft().result()
        finally:
            self._pool.shutdown(wait=True, cancel_futures=True)

    def __call__(self, kind: str, view: int, frame: int, picture: np.ndarray) -> None:
        """Take a picture; it is written soon, or an earlier one's error is raised."""
        folder = self._folder / kind / self._cameras[view]
        if frame == 0:
            folder.mkdir(parents=True, exist_ok=True)
        suffix = "exr" if kind == EXR else "png"
        self._waiting.append(self._pool.submit(_write, folder / f"{frame:06d}.{suffix}", picture, kind in _NOISY))
        while len(self._waiting) > _WAITING:
            self.bytes += self._waiting.popleft().result()


def _write(path: Path, picture: np.ndarray, noisy: bool) -> int:
    if path.suffix == ".exr":
        data = exr_bytes({name: picture[..., i] for i, name in enumerate("RGBZ")})
    else:
        data = png_bytes(picture, noisy=noisy)
    path.write_bytes(data)
    return len(data)
