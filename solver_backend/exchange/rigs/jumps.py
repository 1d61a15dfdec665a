"""Report jumps of a whole figure, and interpolate short ones after which the figure returns."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from ..diagnostics import Diagnostic, diagnostic
from ..so3 import matrix_from_rotvec, rotvec_from_matrix

_FASTEST_M_S, _LEAST_M = 20.0, 0.3
"""Impossible pelvis speed in m/s (the fastest runners reach 12.5), and smallest jump per frame in metres."""
_LONGEST_S = 0.5  # Longest jump in seconds that is interpolated. A longer one may be a cut, so it is only reported.


def bridge_jumps(
    joints: np.ndarray, turns: np.ndarray, pelvis: int, fps: float
) -> tuple[np.ndarray, np.ndarray, list[Diagnostic]]:
    """Interpolate short runs of frames in which the figure jumps away, and report all jumps.

    Args:
        joints: (F, J, 3) joint positions in metres.
        turns: (F, J, 3, 3) rotations.
        pelvis: index of the joint that represents the figure's position.
        fps: frames per second.

    Returns:
        Joints and rotations (unchanged if there are no jumps), and diagnostics of interpolated and of remaining jumps.
    """
    place = joints[:, pelvis]
    steps = np.linalg.norm(np.diff(place, axis=0), axis=1)
    leaps = 1 + np.flatnonzero(steps > max(_FASTEST_M_S / fps, _LEAST_M))
    if not len(leaps):
        return joints, turns, []
    pieces = list(zip([0, *leaps.tolist()], [*leaps.tolist(), len(place)], strict=True))
    kept = _kept(place, pieces, fps)
    good = np.concatenate([np.full(stop - first, keep) for (first, stop), keep in zip(pieces, kept, strict=True)])
    bad = [(first, stop - 1) for (first, stop), keep in zip(pieces, kept, strict=True) if not keep]
    still = [(first - 1, first) for first in leaps.tolist() if good[first - 1] and good[first]]
    found = [
        diagnostic("motion_too_fast", frames=frames, size=_fastest(steps, frames) * fps, done=done)
        for frames, done in ((bad, "interpolated"), (still, "kept"))
        if frames
    ]
    return *_interpolated(joints, turns, good), found


def _fastest(steps: np.ndarray, runs: list[tuple[int, int]]) -> float:
    """Return the largest step within runs of frames, including the steps into and out of each run."""
    return float(max(steps[max(first - 1, 0) : last + 1].max() for first, last in runs))


def _kept(place: np.ndarray, pieces: list[tuple[int, int]], fps: float) -> list[bool]:
    """Return which pieces of a path between jumps are kept. The other pieces are interpolated.

    Starting at the longest piece, a piece is kept if it can be reached from the last kept piece at a plausible speed,
    or if it is longer than ``_LONGEST_S``. The first and last piece are always kept. If the gap between two kept pieces
    is too long, or cannot be crossed at a plausible speed, the pieces in the gap are also kept.
    """
    lengths = [stop - first for first, stop in pieces]
    anchor = int(np.argmax(lengths))
    kept = [False] * len(pieces)
    kept[anchor] = True
    for order, near, far in ((range(anchor + 1, len(pieces)), 1, 0), (range(anchor - 1, -1, -1), 0, 1)):
        edge = pieces[anchor][near] - near
        for k in order:
            here = pieces[k][far] - far
            if lengths[k] > _LONGEST_S * fps or _in_reach(place, edge, here, fps):
                kept[k], edge = True, pieces[k][near] - near
    kept[0] = kept[-1] = True
    for a, b in pairwise([k for k, keep in enumerate(kept) if keep]):
        left, back = pieces[a][1], pieces[b][0]
        if back - left > _LONGEST_S * fps or not _in_reach(place, left - 1, back, fps):
            kept[a:b] = [True] * (b - a)
    return kept


def _in_reach(place: np.ndarray, a: int, b: int, fps: float) -> bool:
    return bool(np.linalg.norm(place[b] - place[a]) <= max(_FASTEST_M_S * abs(b - a) / fps, _LEAST_M))


def _interpolated(joints: np.ndarray, turns: np.ndarray, good: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    if good.all():
        return joints, turns
    known, gaps = np.flatnonzero(good), np.flatnonzero(~good)
    after = np.searchsorted(known, gaps)
    a, b = known[(after - 1).clip(min=0)], known[after.clip(max=len(known) - 1)]
    share = ((gaps - a) / np.maximum(b - a, 1)).clip(0.0, 1.0)[:, None, None]
    joints, turns = joints.copy(), turns.copy()
    joints[gaps] = (1.0 - share) * joints[a] + share * joints[b]
    turns[gaps] = turns[a] @ matrix_from_rotvec(share * rotvec_from_matrix(turns[a].swapaxes(-1, -2) @ turns[b]))
    return joints, turns
