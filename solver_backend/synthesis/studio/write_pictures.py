"""Pictures written to a shot's folders by a thread, in bounded memory: ``kind/camera/000000.png``, or ``.exr``."""

from __future__ import annotations

import struct
import zlib
from collections import deque
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from types import TracebackType

import numpy as np

from solver_backend.io.png import png_bytes

_MAGIC, _VERSION = 20000630, 2
_FLOAT, _ZIP = 2, 3
_LINES = 16
"""Lines of one block of ZIP compression, as OpenEXR's format has it."""


def exr_bytes(channels: Mapping[str, np.ndarray]) -> bytes:
    """Return a picture as an OpenEXR file.

    Args:
        channels: (h, w) float32 by name, such as 'Z' or 'R', 'G', 'B'.
    """
    names = sorted(channels)
    planes = np.stack([np.asarray(channels[name], "<f4") for name in names], axis=1)
    height, _, width = planes.shape
    header = _header(names, width, height)
    chunks = []
    for top in range(0, height, _LINES):
        raw = planes[top : top + _LINES].tobytes()
        packed = zlib.compress(_predicted(raw), level=1)
        data = packed if len(packed) < len(raw) else raw
        chunks.append(struct.pack("<ii", top, len(data)) + data)
    first = len(header) + 8 * len(chunks)
    starts = first + np.cumsum([0, *map(len, chunks[:-1])])
    return b"".join([header, starts.astype("<u8").tobytes(), *chunks])


def _header(names: list[str], width: int, height: int) -> bytes:
    listed = b"".join(name.encode() + b"\0" + struct.pack("<iB3xii", _FLOAT, 0, 1, 1) for name in names) + b"\0"
    window = struct.pack("<4i", 0, 0, width - 1, height - 1)
    values = (
        ("channels", "chlist", listed), ("compression", "compression", bytes([_ZIP])),
        ("dataWindow", "box2i", window), ("displayWindow", "box2i", window), ("lineOrder", "lineOrder", b"\0"),
        ("pixelAspectRatio", "float", struct.pack("<f", 1.0)), ("screenWindowCenter", "v2f", struct.pack("<2f", 0, 0)),
        ("screenWindowWidth", "float", struct.pack("<f", 1.0)),
    )  # fmt: skip
    header = b"".join(
        name.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<i", len(value)) + value
        for name, kind, value in values
    )
    return struct.pack("<ii", _MAGIC, _VERSION) + header + b"\0"


def _predicted(raw: bytes) -> bytes:
    """Return the bytes at even places and then those at odd ones, each as the difference to the one before."""
    data = np.frombuffer(raw, np.uint8)
    parted = np.concatenate([data[0::2], data[1::2]]).astype(np.int16)
    parted[1:] = parted[1:] - parted[:-1] + 128
    return parted.astype(np.uint8).tobytes()


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
