"""Readings of single frames by the network: markers and joints."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from solver_backend.exchange.errors import CaptureInvalid, NoDetections
from solver_backend.exchange.progress import Progress, silent
from solver_backend.labelling.outputs import LANDMARKS
from solver_backend.labelling.point_network import CloudReading, PointNetwork

FEWEST_POINTS, MOST_POINTS = 6, 2000
"""Least points of a person, and most points of one frame: the network weighs every pair, 0.6 GB at this number."""
_PART, _PAIRS = 64, 64 * 100**2
"""Most frames and pairs of points that the network reads at once."""


@dataclass(frozen=True)
class FramesRead:
    """The network's reading of the frames (B,), with (B, N) columns of the points and where there are any."""

    frames: np.ndarray
    columns: np.ndarray
    there: np.ndarray
    reading: CloudReading


def read_frames(
    positions: np.ndarray, seen: np.ndarray, frames: np.ndarray, network: PointNetwork
) -> Iterator[FramesRead]:
    """Read frames of a take, some at a time.

    Args:
        seen: (F, N) bool: there is a point.
        frames: numbers of the frames to read.
    """
    size = int(np.clip(_PAIRS // max(int(seen[frames].sum(1).max()), 1) ** 2, 1, _PART))
    for start in range(0, len(frames), size):
        part = frames[start : start + size]
        columns = np.argsort(~seen[part], axis=1, kind="stable")[:, : int(seen[part].sum(1).max())]
        there = np.take_along_axis(seen[part], columns, axis=1)
        points = np.take_along_axis(positions[part], columns[..., None], axis=1)
        yield FramesRead(part, columns, there, network(np.where(there[..., None], points, 0.0), there))


def require_points(seen: np.ndarray) -> None:
    """Check the number of points.

    Raises:
        NoDetections: no frame has enough points.
        CaptureInvalid: a frame has more points than can be compared with one another.
    """
    if not (seen.sum(1) >= FEWEST_POINTS).any():
        raise NoDetections(
            f"In no frame are there {FEWEST_POINTS} points: too few to distinguish markers.", where="markers"
        )
    require_at_most(MOST_POINTS, int(seen.sum(1).max()), f"points in frame {int(seen.sum(1).argmax())}")


def require_at_most(most: int, found: int, what: str) -> None:
    """Raise ``CaptureInvalid`` where there are more things than can be compared with one another."""
    if found > most:
        raise CaptureInvalid(
            f"Labelling is not supported for {found} {what}; at most {most} are compared with one another.",
            where="markers",
            hint="Remove stray points, or cut the take, in the recording program.",
        )


def frame_landmarks(positions: np.ndarray, network: PointNetwork, progress: Progress = silent) -> np.ndarray:
    """Return (F, 77, 3) metres: the network's markers and joints; NaN in frames with too few points.

    Args:
        positions: (F, N, 3) metres, Z up, in any order, NaN where there is no point.

    Raises:
        NoDetections, CaptureInvalid: see ``require_points``.
    """
    seen = np.isfinite(positions).all(-1)
    require_points(seen)
    found = np.full((len(positions), len(LANDMARKS), 3), np.nan)
    frames, done = np.flatnonzero(seen.sum(1) >= FEWEST_POINTS), 0
    for part in read_frames(np.asarray(positions, dtype=np.float64), seen, frames, network):
        found[part.frames] = part.reading.positions
        done += len(part.frames)
        progress("Reading the points", done, len(frames))
    return found
