"""Small videos made for tests: with any pictures, times, sound and rotation."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

COLOURS = np.array([[255, 0, 0], [0, 255, 0], [0, 0, 255]])


def write_timed_video(
    path: Path, pictures: Iterable[np.ndarray], times_s: Sequence[float], sound: np.ndarray | None = None,
    rate_hz: int = 16_000, *, options: dict[str, str] | None = None, container_options: dict[str, str] | None = None,
    aspect: Fraction = Fraction(1),
) -> Path:  # fmt: skip
    """Write (H, W, 3) uint8 pictures shown at these times, in milliseconds, and sound of one channel from time 0.

    The container is the one of the path's ending. Pixels are shown ``aspect`` times as wide as high.
    """
    av = pytest.importorskip("av")
    with av.open(str(path), "w", options=container_options or {}) as container:
        video = container.add_stream("libx264", rate=60)
        video.codec_context.time_base, video.codec_context.sample_aspect_ratio = Fraction(1, 1000), aspect
        audio = container.add_stream("aac", rate=rate_hz, layout="mono") if sound is not None else None
        for number, (rgb, when) in enumerate(zip(pictures, times_s, strict=True)):
            if number == 0:
                video.height, video.width, video.pix_fmt = rgb.shape[0], rgb.shape[1], "yuv444p"
                video.options = {"crf": "10", "preset": "ultrafast", **(options or {})}
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(rgb), format="rgb24")
            frame.pts, frame.time_base = round(1000 * when), Fraction(1, 1000)
            container.mux(video.encode(frame))
        container.mux(video.encode())
        if audio is not None:
            for start in range(0, len(sound) - 1023, 1024):
                piece = np.asarray(sound[None, start : start + 1024], np.float32)
                frame = av.AudioFrame.from_ndarray(piece, format="fltp", layout="mono")
                frame.sample_rate, frame.pts, frame.time_base = rate_hz, start, Fraction(1, rate_hz)
                container.mux(audio.encode(frame))
            container.mux(audio.encode())
    return path


def dots(places: np.ndarray, size: tuple[int, int], radius: int = 2) -> np.ndarray:
    """Return a dark picture (H, W, 3) with a red, a green and a blue square at three (x, y) pixels."""
    picture = np.zeros((size[1], size[0], 3), np.uint8)
    for (x, y), colour in zip(np.round(places).astype(int), COLOURS, strict=True):
        picture[max(y - radius, 0) : y + radius + 1, max(x - radius, 0) : x + radius + 1] = colour
    return picture


def write_dots(path: Path, tracks: np.ndarray, times_s: Sequence[float], size: tuple[int, int] = (160, 120)) -> Path:
    """Write a video of three coloured dots that follow (F, 3, 2) tracks."""
    return write_timed_video(path, (dots(places, size) for places in tracks), times_s)


def turned_by_header(path: Path, degrees: int) -> None:
    """Write a rotation into an MP4's header, like a phone in portrait. Its pictures are unchanged."""
    turn = {90: (0, 1, -1, 0), 180: (-1, 0, 0, -1), 270: (0, -1, 1, 0)}[degrees]
    data = bytearray(path.read_bytes())
    at = data.index(b"tkhd") + 4 + 40
    a, b, c, d = (value << 16 for value in turn)
    data[at : at + 36] = struct.pack(">9i", a, b, 0, c, d, 0, 0, 0, 1 << 30)
    path.write_bytes(bytes(data))
