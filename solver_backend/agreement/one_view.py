"""Follow people in a single view from frame to frame by their keypoints."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from solver_backend.agreement.detections import Detections
from solver_backend.agreement.person_selection import SelectedPerson
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.errors import NoDetections
from solver_backend.types import UNSEEN_POINT, Keypoints2D

NEAR_SHARE = 0.4  # Largest median step of one person's keypoints, in the person's extent.
GONE_S = 0.5  # Longest absence of one person.
LEAST_SHARE = 0.25  # Least share of the longest track's frames. Shorter tracks are passers-by.
LEAST_POINTS = 4  # Least keypoints of a person.


@dataclass
class _Track:
    """One person as they are followed."""

    frames: list[int] = field(default_factory=list)
    rows: list[int] = field(default_factory=list)
    size: float = 0.0


def select_in_one_view(detections: Detections, fps: float) -> tuple[SelectedPerson, ...]:
    """Return the people of one view, ordered by size times duration.

    Args:
        detections: of one view.
        fps: frames per second.

    Raises:
        NoDetections: no person is detected.
    """
    count = detections.joint_set.num_keypoints
    xy, confidence = detections.xy[0, :, :, :count], detections.confidence[0, :, :, :count]
    tracks = _followed(xy, confidence, max(1.0, GONE_S * fps))
    if not tracks:
        raise NoDetections(
            "Nobody is detected.", where=", ".join(detections.cameras), hint="Run the detector again."
        )  # fmt: skip
    tracks.sort(key=lambda track: -track.size)
    longest = max(len(track.frames) for track in tracks)
    kept = [track for track in tracks if track is tracks[0] or len(track.frames) >= LEAST_SHARE * longest]
    selected: list[SelectedPerson] = []
    for number, track in enumerate(kept, 1):
        points, sure = np.full((len(xy), *xy.shape[2:]), np.nan), np.zeros((len(xy), xy.shape[2]))
        chosen = np.full((1, len(xy)), -1)
        points[track.frames], sure[track.frames] = xy[track.frames, track.rows], confidence[track.frames, track.rows]
        chosen[0, track.frames] = track.rows
        hands = None
        if detections.hands is not None:
            hands = np.full((1, len(xy), *detections.hands.shape[3:]), UNSEEN_POINT, detections.hands.dtype)
            hands[0, track.frames] = detections.hands[0, track.frames, track.rows]
        keypoints = Keypoints2D(points[None], sure[None], detections.joint_set, fps, hands)
        notes = () if selected else _notes(kept, len(tracks), len(xy))
        own = [point.name for point in detections.own if not selected]
        problems = (diagnostic("own_point_unused", reason="single", joints=own),) if own else ()
        selected.append(SelectedPerson(f"Person {number}", keypoints, chosen, notes, problems))
    return tuple(selected)


def _notes(kept: list[_Track], count: int, frames: int) -> tuple[Diagnostic, ...]:
    first = diagnostic("person_chosen", basis="largest", seen=len(kept[0].frames), of=frames)
    others = () if count == 1 else (diagnostic("other_tracks", count=count - 1, solvable=len(kept) - 1),)
    return (first, *others)


def _followed(xy: np.ndarray, confidence: np.ndarray, gone: float) -> list[_Track]:
    """Return the tracks through (F, P, K, 2) detections, linking nearest pairs first."""
    tracks: list[_Track] = []
    present = (confidence > 0).sum(axis=-1) >= LEAST_POINTS
    extent = _extents(xy, confidence)
    for frame in range(len(xy)):  # a picture follows from the one before
        free = np.flatnonzero(present[frame]).tolist()
        living = [track for track in tracks if frame - track.frames[-1] <= gone]
        pairs = sorted(
            (distance, n, row)
            for n, track in enumerate(living)
            for row in free
            if (distance := _distance(xy, confidence, extent, track, frame, row)) < NEAR_SHARE
        )
        for _, n, row in pairs:
            if row in free and living[n].frames[-1] != frame:
                free.remove(row)
                _append(living[n], frame, row, extent)
        for row in free:
            tracks.append(_Track())
            _append(tracks[-1], frame, row, extent)
    return tracks


def _append(track: _Track, frame: int, row: int, extent: np.ndarray) -> None:
    track.frames.append(frame)
    track.rows.append(row)
    track.size += float(extent[frame, row])


def _distance(
    xy: np.ndarray, confidence: np.ndarray, extent: np.ndarray, track: _Track, frame: int, row: int
) -> float:  # fmt: skip
    """Return the median distance of the keypoints that both have, over the larger extent. Infinite where none are."""
    last, before = track.frames[-1], track.rows[-1]
    both = (confidence[frame, row] > 0) & (confidence[last, before] > 0)
    if not both.any():
        return float("inf")
    apart = float(np.median(np.linalg.norm(xy[frame, row, both] - xy[last, before, both], axis=-1)))
    return apart / max(float(extent[frame, row]), float(extent[last, before]), 1e-6)


def _extents(xy: np.ndarray, confidence: np.ndarray) -> np.ndarray:
    """Return (F, P) diagonals of the boxes about the keypoints, pixels."""
    seen = (confidence > 0)[..., None]
    span = np.where(seen, xy, -np.inf).max(axis=2) - np.where(seen, xy, np.inf).min(axis=2)
    return np.where(seen.any(axis=(2, 3)), np.hypot(span[..., 0], span[..., 1]), 0.0)
