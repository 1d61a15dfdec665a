"""Frame rate, length and size of a video from its MP4 or QuickTime header, without a decoder."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from solver_backend.exchange.regular_file import open_regular

_LARGEST_HEADER = 1 << 26
"""Bytes; ten hours of video have less."""
_MOST_BOXES = 10_000
"""Boxes of a file that are looked at; chosen by hand."""
_QUARTER_TURNS = {(0, 1, -1, 0), (0, -1, 1, 0)}


@dataclass(frozen=True)
class VideoHeader:
    """What the header of a video states."""

    fps: float
    """Frames per second, the mean over the video."""
    num_frames: int
    """Number of frames."""
    size: tuple[int, int]
    """Width and height in pixels, as a player shows it (rotated if the header states it)."""


def read_video_header(path: Path) -> VideoHeader | None:
    """Return the header of the first video track; None where the file is no MP4 or holds no such thing.

    ``fps = timescale * Σ count / Σ (count * duration)`` over the table of sample durations (ISO/IEC 14496-12, stts).
    """
    try:
        with open_regular(path) as stream:
            moov = top_level_box(stream, b"moov")
        return None if moov is None else _video_track(memoryview(moov))
    except (OSError, struct.error, IndexError, ValueError, OverflowError):
        return None


def top_level_box(stream: BinaryIO, wanted: bytes) -> bytes | None:
    """Return the content of the first box of this kind outside of all others; None where there is none."""
    for _ in range(_MOST_BOXES):
        if len(head := stream.read(8)) < 8:
            return None
        size, kind = struct.unpack(">I4s", head)
        used = 8
        if size == 1:
            size, used = struct.unpack(">Q", stream.read(8))[0], 16
        if kind == wanted:
            return stream.read(min(size - used, _LARGEST_HEADER) if size else _LARGEST_HEADER)
        if size < used:
            return None
        stream.seek(size - used, 1)
    return None


def boxes(data: memoryview) -> Iterator[tuple[bytes, memoryview]]:
    """Yield kind and content of each box in a box."""
    at = 0
    for _ in range(_MOST_BOXES):
        if at + 8 > len(data):
            return
        size, kind = struct.unpack_from(">I4s", data, at)
        used = 8
        if size == 1:
            size, used = struct.unpack_from(">Q", data, at + 8)[0], 16
        end = at + size if size else len(data)
        if end < at + used:
            return
        yield kind, data[at + used : end]
        at = end


def inside(data: memoryview, *kinds: bytes) -> memoryview:
    """Return the content of the first box found by following ``kinds`` inwards."""
    for kind in kinds:
        data = next((content for found, content in boxes(data) if found == kind), memoryview(b""))
    return data


def _video_track(moov: memoryview) -> VideoHeader | None:
    for kind, track in boxes(moov):
        if kind != b"trak" or inside(track, b"mdia", b"hdlr")[8:12] != b"vide":
            continue
        media = inside(track, b"mdia", b"mdhd")
        timescale = struct.unpack_from(">I", media, 20 if media[0] == 1 else 12)[0]
        table = inside(track, b"mdia", b"minf", b"stbl", b"stts")
        entries = struct.unpack_from(">I", table, 4)[0]
        counts, durations = np.frombuffer(table[8:], ">u4", 2 * entries).reshape(-1, 2).astype(np.float64).T
        frames, ticks = int(counts.sum()), int(counts @ durations)
        size = _shown_size(inside(track, b"tkhd"))
        if not (frames and ticks and timescale and all(size)):
            return None
        return VideoHeader(timescale * frames / ticks, frames, size)
    return None


def _shown_size(tkhd: memoryview) -> tuple[int, int]:
    at = 52 if tkhd[0] == 1 else 40
    a, b, _, c, d = struct.unpack_from(">5i", tkhd, at)
    width, height = (value >> 16 for value in struct.unpack_from(">II", tkhd, at + 36))
    rotated = tuple(value >> 16 for value in (a, b, c, d)) in _QUARTER_TURNS
    return (height, width) if rotated else (width, height)
