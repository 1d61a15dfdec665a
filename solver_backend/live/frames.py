"""Where live points come from: a file played at its own rate, or lines."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TextIO

import numpy as np

from solver_backend.types import MarkerCloud

MOST_POINTS = 400
"""More in one frame are no marker cloud of a person."""

_LONGEST_LINE = 1 << 17


@dataclass(frozen=True)
class PointFrame:
    """The points of a moment."""

    time: float
    """Seconds on the source's clock."""
    points: np.ndarray
    """(N, 3) in the source's unit and axes."""
    arrived: float
    """``time.perf_counter()`` when it came."""
    fault: str = ""
    """What is wrong with the line, where there are no points to be had from it."""


def replayed(cloud: MarkerCloud, *, paced: bool = True, repeat: bool = False) -> Iterator[PointFrame]:
    """Yield the frames of a take at its own rate, or as fast as they are taken; points in an order of their own."""
    start, number = time.perf_counter(), 0
    while True:
        for frame in cloud.positions:
            at = number / cloud.fps
            if paced and (ahead := start + at - time.perf_counter()) > 0:
                time.sleep(ahead)
            yield PointFrame(at, frame[np.isfinite(frame).all(-1)], time.perf_counter())
            number += 1
        if not repeat:
            return


def from_lines(stream: TextIO, fps: float = 120.0) -> Iterator[PointFrame]:
    """Yield a frame a line: ``{"t": seconds, "points": [[x, y, z], ...]}``, or numbers: the time, then x y z of each.

    A line that is neither is yielded with its fault; empty lines are left out, and so are events of whoever sends them.
    """
    number = 0
    while line := stream.readline(_LONGEST_LINE):
        arrived, text = time.perf_counter(), line.strip()
        if not text or text.startswith('{"event":'):
            continue
        try:
            _require_whole(line, stream)
            at, points = _parsed(text, number / fps)
            yield PointFrame(at, points, arrived)
        except (ValueError, TypeError, KeyError, RecursionError, OverflowError) as error:
            yield PointFrame(math.nan, np.zeros((0, 3)), arrived, _said(error))
        number += 1


def _require_whole(line: str, stream: TextIO) -> None:
    """Pass over the rest of a line that is longer than any frame's."""
    if len(line) < _LONGEST_LINE or line.endswith("\n"):
        return
    while len(rest := stream.readline(_LONGEST_LINE)) == _LONGEST_LINE and not rest.endswith("\n"):
        pass
    raise ValueError(f"it has more than {_LONGEST_LINE} letters")


def _parsed(text: str, clock: float) -> tuple[float, np.ndarray]:
    if text.startswith("{"):
        values = json.loads(text)
        points = np.asarray(values["points"], dtype=np.float64).reshape(-1, 3)
        at = float(values.get("t", clock))
    else:
        # Not np.array of texts: each would take as much memory as the longest.
        numbers = np.array([float(word) for word in text.replace(",", " ").replace(";", " ").split()])
        if len(numbers) % 3 != 1:
            raise ValueError(f"{len(numbers)} numbers are no time and points of three each")
        at, points = float(numbers[0]), numbers[1:].reshape(-1, 3)
    if not math.isfinite(at):
        raise ValueError("the time is no number")
    points = points[np.isfinite(points).all(-1)]
    if len(points) > MOST_POINTS:
        raise ValueError(f"{len(points)} points in one frame; at most {MOST_POINTS} are read")
    return at, points


def _said(error: Exception) -> str:
    return f"the line is none of ours ({str(error)[:80]})"
