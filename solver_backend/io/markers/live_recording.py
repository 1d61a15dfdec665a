"""Record live points in a growing file of independent blocks, and read such files.

A block is little-endian. It starts with 8 marker bytes, the number of points (uint32), and a CRC-32 of the rest, seeded
with the number of points (uint32). The rest is the time in seconds, the nominal rate, and the 3 x 3 transform of points
to metres with Z up (11 float64, NaN if unknown), and x, y, z of each point in the source's unit and axes (float32).
Damaged blocks are skipped.
"""

from __future__ import annotations

import struct
import zlib
from array import array
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import BinaryIO

import numpy as np

from solver_backend.exchange.diagnostics import diagnostic
from solver_backend.exchange.errors import FileDamaged, NoDetections
from solver_backend.exchange.outputs import open_regular, require_file, unreadable
from solver_backend.exchange.plausible import FRAME_RATES
from solver_backend.io.markers.source import MarkerSource

SUFFIX = ".recording"  # Suffix added to the name of the final file while recording.
MARK = b"MMLIVE1\n"
MOST_POINTS = 400  # Largest number of points per frame. More points cannot be one person's markers.
_HEAD, _FIXED = struct.Struct("<8sII"), struct.Struct("<11d")
_SEARCHED = 64, 1 << 20  # First and largest number of bytes to search for the next block. It doubles each time.
MOST_NUMBERS = 400_000_000  # Largest number of coordinates: 1.6 GB, more than six hours of 60 points at 100 Hz.
DEFAULT_RATE = 120.0  # Frames per second if a recording has no time stamps, chosen by hand.


@dataclass(frozen=True)
class LiveBlock:
    """One frame of points in a live recording, which is a sequence of blocks."""

    time: float  # Time stamp in seconds on the source's clock.
    points: np.ndarray  # (N, 3) float32 in the source's unit and axes.
    fps: float | None = None  # Nominal rate, or None if unknown.
    to_metres: np.ndarray | None = None  # (3, 3) transform of the points to metres with Z up, or None if unknown.


@dataclass(frozen=True)
class LiveExtent:
    """Size and properties of a live recording."""

    frames: int  # Number of complete blocks.
    most: int  # Largest number of points in any frame.
    rate: float  # Frames per second, see ``rate_of``.
    last: float  # Time stamp of the last frame in seconds, or NaN if there are no frames.
    to_metres: np.ndarray | None  # (3, 3) transform of the points to metres, or None if unknown.
    largest: float  # Largest absolute coordinate in the source's unit.
    damaged: int  # Number of bytes outside complete blocks.


def pack_block(block: LiveBlock) -> bytes:
    """Encode one frame of live points as the bytes of a block."""
    turn = np.full(9, np.nan) if block.to_metres is None else np.ravel(block.to_metres)
    body = _FIXED.pack(block.time, np.nan if block.fps is None else block.fps, *turn)
    body += np.ascontiguousarray(block.points, "<f4").tobytes()
    count = len(block.points)
    return _HEAD.pack(MARK, count, zlib.crc32(body, count)) + body


def read_blocks(stream: BinaryIO) -> Iterator[LiveBlock | int]:
    """Yield the complete blocks of a recording, and the number of damaged bytes between them."""
    damaged, at = 0, stream.tell()
    while head := stream.read(_HEAD.size):
        block, size = _block(head, stream)
        if block is not None:
            if damaged:
                yield damaged
            damaged, at = 0, at + size
            yield block
            continue
        step = _next_mark(stream, at + 1) - at
        damaged, at = damaged + step, at + step
        stream.seek(at)
    if damaged:
        yield damaged


def _block(head: bytes, stream: BinaryIO) -> tuple[LiveBlock | None, int]:
    """Decode the block that begins with ``head``. Return the block and its length, or (None, 0) if it is damaged."""
    if len(head) < _HEAD.size:
        return None, 0
    mark, count, check = _HEAD.unpack(head)
    if mark != MARK or count > MOST_POINTS:
        return None, 0
    body = stream.read(_FIXED.size + 12 * count)
    if len(body) < _FIXED.size + 12 * count or zlib.crc32(body, count) != check:
        return None, 0
    time, fps, *turn = _FIXED.unpack_from(body)
    points = np.frombuffer(body, "<f4", offset=_FIXED.size).reshape(-1, 3)
    known = np.array(turn).reshape(3, 3)
    to_metres = known if np.isfinite(known).all() else None
    return LiveBlock(time, points, fps if np.isfinite(fps) else None, to_metres), len(head) + len(body)


def _next_mark(stream: BinaryIO, at: int) -> int:
    size, most = _SEARCHED
    while True:
        stream.seek(at)
        part = stream.read(size)
        if (found := part.find(MARK)) >= 0:
            return at + found
        if len(part) < size:
            return at + len(part)
        at, size = at + size - len(MARK) + 1, min(2 * size, most)


def measure_recording(stream: BinaryIO) -> LiveExtent:
    """Read a recording once to determine its extent. Only the time stamps are kept in memory."""
    times, fps, turn, most, largest, damaged = array("d"), None, None, 0, 0.0, 0
    for block in read_blocks(stream):
        if isinstance(block, int):
            damaged += block
            continue
        times.append(block.time)
        fps, most = block.fps or fps, max(most, len(block.points))
        turn = turn if block.to_metres is None else block.to_metres
        largest = max(largest, float(np.abs(block.points).max(initial=0.0)))
    at = np.array(times)
    return LiveExtent(len(at), most, rate_of(at, fps), at[-1] if len(at) else np.nan, turn, largest, damaged)


def rate_of(times: np.ndarray, fps: float | None) -> float:
    """Return the nominal frame rate if it is plausible, otherwise the rate of the median time step."""
    with np.errstate(all="ignore"):
        steps = np.diff(times)
        measured = 1.0 / float(np.median(steps[steps > 0])) if (steps > 0).any() else np.nan
    rates = (rate for rate in (fps, measured) if rate and FRAME_RATES[0] <= rate <= FRAME_RATES[1])
    return next(rates, DEFAULT_RATE)


def read_parts(stream: BinaryIO, most: int, frames: int) -> Iterator[np.ndarray]:
    """Yield the points of up to ``frames`` frames at a time, as (F, ``most``, 3) with NaN after the last point."""
    blocks = (block for block in read_blocks(stream) if isinstance(block, LiveBlock))
    while taken := list(islice(blocks, frames)):
        part = np.full((len(taken), most, 3), np.nan, np.float32)
        for row, block in zip(part, taken, strict=True):
            row[: len(block.points)] = block.points
        yield part


def read_live_recording(path: Path) -> MarkerSource:
    """Read a live recording that ended unexpectedly."""
    path = require_file(path)
    try:
        with open_regular(path) as stream:
            extent = measure_recording(stream)
            if not extent.frames:
                raise FileDamaged("The live recording contains no whole frame.", where=str(path), hint="Record again.")
            if not extent.most:
                raise NoDetections("No frame of the live recording has points.", where=str(path), hint="Record again.")
            if 3 * extent.frames * extent.most > MOST_NUMBERS:
                hint = f"At most {MOST_NUMBERS // 3} points are supported. Record in shorter takes."
                what = (
                    f"The live recording has {extent.frames} frames of {extent.most} points, which is too "
                    "large to read at once."
                )
                raise FileDamaged(what, where=str(path), hint=hint)
            stream.seek(0)
            [positions] = read_parts(stream, extent.most, extent.frames)
    except OSError as error:
        raise unreadable(path, error) from error
    problems = [diagnostic("live_recording_incomplete", kind="unfinished", count=extent.frames, time=extent.last)]
    if extent.damaged:
        problems.append(diagnostic("live_recording_incomplete", kind="damaged", bytes=extent.damaged))
    positions, labels = positions.astype(np.float64), ("",) * extent.most
    known = {"problems": tuple(problems), "to_metres": extent.to_metres}
    return MarkerSource(path, "live recording", positions, labels, extent.rate, "m", "z", **known)
