"""A take's tracked points as a cloud of columns, without the tracks that are ghosts."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from solver_backend.sensors.errors import RecordingInvalid
from solver_backend.sensors.fusion.tracks import TrackedPoints
from solver_backend.types import MarkerCloud

_MOST_UNSEEN, _PAUSE = 20, 36_000
"""Frames for each moment with markers, and beside them (ten minutes at 60 a second), beyond which the times are wrong:
milliseconds for seconds would take 6 GB for three moments. Chosen by hand."""


@dataclass
class CloudBuilder:
    """Collects the moments of a take."""

    moments: list[TrackedPoints] = field(default_factory=list)

    def add(self, moment: TrackedPoints) -> None:
        """Take a moment."""
        self.moments.append(moment)

    def cloud(self, fps: float) -> MarkerCloud:
        """Return the take on frames of equal length.

        A track is a marker if its log-odds ever rose above 0; it takes the first column that is free. The cloud's
        residual is each point's standard deviation, ``√(tr Σ / 3)``.

        Raises:
            RecordingInvalid: the moments are so far apart that hardly a frame of the take would have one.
        """
        rows, track, score, points, covariance = self._table(fps)
        if not len(rows):
            return MarkerCloud(np.full((0, 0, 3), np.nan), fps)
        names, of_point = np.unique(track, return_inverse=True)
        best = np.full(len(names), -np.inf)
        np.maximum.at(best, of_point, score)
        kept = (best > 0)[of_point]
        rows, of_point, points, covariance = rows[kept], of_point[kept], points[kept], covariance[kept]
        column = _columns(rows, of_point, len(names))
        frames, width = self._frames(fps), int(column.max(initial=-1)) + 1
        positions = np.full((frames, width, 3), np.nan)
        spread = np.full((frames, width, 3, 3), np.nan)
        positions[rows, column[of_point]] = points
        spread[rows, column[of_point]] = covariance
        residual = np.sqrt(np.trace(spread, axis1=-2, axis2=-1) / 3.0)
        return MarkerCloud(positions, fps, None, residual, spread)

    def _frames(self, fps: float) -> int:
        span_s = self.moments[-1].time - self.moments[0].time
        if span_s * fps > _MOST_UNSEEN * len(self.moments) + _PAUSE:
            raise RecordingInvalid(
                f"{len(self.moments)} moments with markers span {span_s:.0f} s at {fps:g} a second.",
                where="index.csv", hint="Times of an index are in seconds; record what has long pauses in parts.",
            )  # fmt: skip
        return round(span_s * fps) + 1

    def _table(self, fps: float) -> tuple[np.ndarray, ...]:
        start = self.moments[0].time if self.moments else 0.0
        rows = [np.full(len(m.points), round((m.time - start) * fps)) for m in self.moments]
        empty = np.zeros(0, int)
        return (
            np.concatenate([empty, *rows]), np.concatenate([empty, *(m.track for m in self.moments)]),
            np.concatenate([np.zeros(0), *(m.score for m in self.moments)]),
            np.concatenate([np.zeros((0, 3)), *(m.points for m in self.moments)]),
            np.concatenate([np.zeros((0, 3, 3)), *(m.covariance for m in self.moments)]),
        )  # fmt: skip


def _columns(rows: np.ndarray, track: np.ndarray, count: int) -> np.ndarray:
    """Return the column of each of ``count`` tracks: the first whose last track has ended."""
    first, last = np.full(count, np.iinfo(int).max), np.full(count, -1)
    np.minimum.at(first, track, rows)
    np.maximum.at(last, track, rows)
    column, ends = np.full(count, -1), np.zeros(0, int)
    for one in np.argsort(first, kind="stable").tolist():
        if last[one] < 0:
            continue
        free = np.flatnonzero(ends < first[one])
        if len(free):
            column[one] = free[0]
            ends[free[0]] = last[one]
        else:
            column[one] = len(ends)
            ends = np.append(ends, last[one])
    return column
