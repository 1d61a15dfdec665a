"""From people frame by frame to persons over time: tracklets by nearness, then tracklets of one person joined."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from solver_backend.people.view_agreement import PeopleInSpace

STEP_M = 0.2
"""A person's middle moves and is mismeasured by no more than this ..."""
SPEED_M_S = 4.0
"""... plus this speed times the time between two sightings; twice that where a view's own track holds both."""
BRIDGE_S = 0.5
"""Longer absences end a tracklet."""
OVERLAP_S = 0.1
"""Two pieces of one person may overlap by this time, where a wrong pairing of detections prolonged the first."""
LIVELY_M = 0.15
"""The keypoints of someone who moves range over this distance."""
JOIN_SPEED_M_S = 3.0
"""Speed at which a person may have walked while no two views saw them."""


@dataclass
class _Tracklet:
    rows: list[int] = field(default_factory=list)
    last_frame: int = 0
    last_middle: tuple[float, float, float] = (0.0, 0.0, 0.0)
    last_tracks: frozenset[int] = frozenset()


def persons(people: PeopleInSpace, tracks: np.ndarray, fps: float) -> list[np.ndarray]:
    """Return for each person the rows of ``people`` that are them, by frame; the most agreed on first.

    Persons are ordered by the sum over their rows of (score - 1)², where the score grows with the views that agree: a
    frame seen by four views counts for nine seen by two. Who never moves, such as a mannequin, counts for half.

    Args:
        people: people of all frames.
        tracks: (C, F, P) number of the view's own track each detection belongs to.
        fps: frames per second.
    """
    if not len(people.frame):
        return []
    middles = middles_of(people.points)
    in_views = _tracks_of(people, tracks)
    joined = [
        _once_a_frame(people, rows)
        for rows in _joined(_tracklets(people, middles, in_views, fps), people.frame, middles, in_views, fps)
    ]
    weights = [_weight(people, rows) for rows in joined]
    return [joined[i] for i in np.argsort(weights)[::-1]]


def _weight(people: PeopleInSpace, rows: np.ndarray) -> float:
    agreement = np.maximum(people.score[rows] - 1.0, 0.05) ** 2
    points = people.points[rows]
    low, high = (np.quantile(np.nan_to_num(points), q, axis=0) for q in (0.1, 0.9))
    moves = min(1.0, float(np.median(np.linalg.norm(high - low, axis=-1))) / LIVELY_M)
    return float(agreement.sum()) * (0.5 + 0.5 * moves)


def middles_of(points: np.ndarray) -> np.ndarray:
    """Return (H, 3) the coordinate-wise median of each person's known points, (H, J, 3)."""
    known = np.isfinite(points[..., 0]).sum(-1)
    ordered = np.sort(points, axis=1)
    index = np.maximum(known - 1, 0) // 2
    return np.take_along_axis(ordered, np.broadcast_to(index[:, None, None], (len(points), 1, 3)), axis=1)[:, 0]


def _tracks_of(people: PeopleInSpace, tracks: np.ndarray) -> list[frozenset[int]]:
    """Return the numbers of the views' tracks that each person's detections belong to."""
    views = np.arange(people.members.shape[1])
    numbers = np.where(people.members >= 0, tracks[views, people.frame[:, None], people.members], -1)
    return [frozenset(n for n in row if n >= 0) for row in numbers.tolist()]


def _once_a_frame(people: PeopleInSpace, rows: np.ndarray) -> np.ndarray:
    """Return the rows by frame, the best where two are of one frame."""
    ordered = rows[np.lexsort([-people.score[rows], people.frame[rows]])]
    return ordered[np.unique(people.frame[ordered], return_index=True)[1]]


def _tracklets(
    people: PeopleInSpace, middles: np.ndarray, in_views: list[frozenset[int]], fps: float
) -> list[np.ndarray]:
    """Link sightings of neighbouring frames: first those that share tracks of views, then the nearest."""
    active: list[_Tracklet] = []
    finished: list[_Tracklet] = []
    frames = people.frame
    starts = np.flatnonzero(np.diff(frames, prepend=-1))
    positions = [(float(x), float(y), float(z)) for x, y, z in middles]
    for start, stop in zip(starts.tolist(), [*starts[1:].tolist(), len(frames)], strict=True):
        frame = int(frames[start])
        finished += [t for t in active if (frame - t.last_frame) / fps > BRIDGE_S]
        active = [t for t in active if (frame - t.last_frame) / fps <= BRIDGE_S]
        links = []
        for i, track in enumerate(active):
            reach = STEP_M + SPEED_M_S * min((frame - track.last_frame) / fps, 0.1)
            for row in range(start, stop):
                shared = len(track.last_tracks & in_views[row])
                distance = _distance(track.last_middle, positions[row])
                if distance <= (2 * reach if shared else reach):
                    links.append((-shared, distance, i, row))
        used_tracks: set[int] = set()
        used_rows: set[int] = set()
        for _, _, i, row in sorted(links):
            if i not in used_tracks and row not in used_rows:
                used_tracks.add(i)
                used_rows.add(row)
                _extend(active[i], frame, row, positions[row], in_views[row])
        for row in range(start, stop):
            if row not in used_rows:
                active.append(_Tracklet())
                _extend(active[-1], frame, row, positions[row], in_views[row])
    return [np.array(t.rows) for t in [*finished, *active]]


def _extend(
    track: _Tracklet, frame: int, row: int, middle: tuple[float, float, float], in_views: frozenset[int]
) -> None:
    track.rows.append(row)
    track.last_frame, track.last_middle, track.last_tracks = frame, middle, in_views


def _distance(a: Sequence[float], b: Sequence[float]) -> float:
    return ((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2) ** 0.5


def _joined(
    tracklets: list[np.ndarray], frames: np.ndarray, middles: np.ndarray, in_views: list[frozenset[int]], fps: float
) -> list[np.ndarray]:
    """Join tracklets that follow each other in time; every end finds at most one beginning.

    First those that share tracks of views, which one camera may have gone on seeing, then those near enough.
    """
    first = np.array([frames[rows[0]] for rows in tracklets])
    last = np.array([frames[rows[-1]] for rows in tracklets])
    begin = np.stack([middles[rows[0]] for rows in tracklets])
    end = np.stack([middles[rows[-1]] for rows in tracklets])
    absence_s = (first[None, :] - last[:, None]) / fps
    distance = np.linalg.norm(end[:, None] - begin[None], axis=-1)
    cost = distance / (2 * STEP_M + JOIN_SPEED_M_S * np.maximum(absence_s, 0.0))
    ends = [frozenset().union(*(in_views[row] for row in rows[-5:])) for rows in tracklets]
    begins = [frozenset().union(*(in_views[row] for row in rows[:5])) for rows in tracklets]
    shared = np.array([[len(a & b) for b in begins] for a in ends])
    later = (first[None, :] > first[:, None]) & (last[None, :] > last[:, None])
    possible = later & (absence_s > -OVERLAP_S) & (cost < np.where(shared > 0, 3.0, 1.0))
    # Among near candidates the one after the shorter absence is the likelier, hence the last term.
    total = np.where(possible, cost - 3.0 * shared + 0.1 * np.log1p(np.maximum(absence_s, 0.0)), np.inf)
    follower = np.full(len(tracklets), -1)
    followed = np.zeros(len(tracklets), bool)
    for flat in np.argsort(total, axis=None)[: int(possible.sum())]:
        a, b = divmod(int(flat), len(tracklets))
        if follower[a] < 0 and not followed[b]:
            follower[a], followed[b] = b, True
    joined = []
    for start in np.flatnonzero(~followed):
        pieces, i = [], int(start)
        while i >= 0:
            pieces.append(tracklets[i])
            i = int(follower[i])
        joined.append(np.concatenate(pieces))
    return joined
