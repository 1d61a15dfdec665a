"""Where live points come from: a file played at its own rate, or lines."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import BinaryIO

import numpy as np

from solver_backend.io.markers.live_recording import MOST_POINTS
from solver_backend.types import MarkerCloud

FARTHEST = 1e8
"""A coordinate at least this large is no marker's, in whichever unit: 100 km in millimetres."""

_LONGEST_LINE = 1 << 17
"""Bytes of a line: 400 points of three numbers of 100 digits."""


@dataclass(frozen=True)
class PointFrame:
    """The points of a moment."""

    time: float
    """Seconds on the source's clock."""
    points: np.ndarray
    """(N, 3) in the source's unit and axes."""
    arrived: float
    """``time.perf_counter()`` when it came, or when a replay took it up."""
    fault: str = ""
    """What is wrong with the line, where there are no points to be had from it."""
    due: float | None = None
    """``time.perf_counter()`` from which a pose can be expected, where that is not when it came."""

    @property
    def lag_s(self) -> float:
        """Seconds by which a pose of it is behind by now."""
        return time.perf_counter() - (self.arrived if self.due is None else self.due)


def replayed(cloud: MarkerCloud, *, paced: bool = True, repeat: bool = False) -> Iterator[PointFrame]:
    """Yield the frames of a take at its own rate, or as fast as they are taken; points in an order of their own."""
    start, number = time.perf_counter(), 0
    while True:
        for frame in cloud.positions:
            at = number / cloud.fps
            if paced and (ahead := start + at - time.perf_counter()) > 0:
                time.sleep(ahead)
            came = time.perf_counter()
            yield PointFrame(at, measured(frame), came, due=start + at if paced else came)
            number += 1
        if not repeat:
            return


def measured(points: np.ndarray) -> np.ndarray:
    """Return those of (N, 3) points that can be markers: finite, and not at the other end of the world."""
    return points[(np.abs(points) < FARTHEST).all(-1)]


def from_lines(stream: BinaryIO, fps: float = 120.0) -> Iterator[PointFrame]:
    """Yield a frame a line: ``{"t": seconds, "points": [[x, y, z], ...]}``, or numbers: the time, then x y z of each.

    A line that is neither is yielded with its fault; empty lines are left out, and so are events of whoever sends them.
    Bytes that are no UTF-8 are part of such a line, and end nothing.
    """
    number = 0
    while line := stream.readline(_LONGEST_LINE):
        arrived, text = time.perf_counter(), line.decode("utf-8", "replace").strip()
        if not text or text.startswith('{"event":'):
            continue
        try:
            _require_whole(line, stream)
            at, points = _parsed(text, number / fps)
            yield PointFrame(at, points, arrived)
        except (ValueError, TypeError, KeyError, RecursionError, OverflowError) as error:
            yield PointFrame(math.nan, np.zeros((0, 3)), arrived, _message(error))
        number += 1


def _require_whole(line: bytes, stream: BinaryIO) -> None:
    """Pass over the rest of a line that is longer than any frame's."""
    if len(line) < _LONGEST_LINE or line.endswith(b"\n"):
        return
    while len(rest := stream.readline(_LONGEST_LINE)) == _LONGEST_LINE and not rest.endswith(b"\n"):
        pass
    raise ValueError(f"it has more than {_LONGEST_LINE} bytes")


def _parsed(text: str, clock: float) -> tuple[float, np.ndarray]:
    if text.startswith("{"):
        values = json.loads(text)
        points = np.asarray(values["points"], dtype=np.float64).reshape(-1, 3)
        at = float(values.get("t", clock))
    else:
        # Not np.array of texts: each would take as much memory as the longest.
        numbers = np.array([float(word) for word in text.replace(",", " ").replace(";", " ").split()])
        if len(numbers) % 3 != 1:
            raise ValueError(f"{len(numbers)} numbers are not a time and points of three each")
        at, points = float(numbers[0]), numbers[1:].reshape(-1, 3)
    if not math.isfinite(at):
        raise ValueError("the time is not a number")
    points = measured(points)
    if len(points) > MOST_POINTS:
        raise ValueError(f"{len(points)} points in one frame; at most {MOST_POINTS} are read")
    return at, points


def _message(error: Exception) -> str:
    return f"the line is not in our format ({str(error)[:80]})"
