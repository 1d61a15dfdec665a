"""Choose the person to solve by agreement between the views, so that a bystander is never mixed in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.errors import NoDetections, TooFewViews
from solver_backend.io.detections import Detections
from solver_backend.io.person_tracks import persons
from solver_backend.io.settled_people import concatenated, settled
from solver_backend.io.sightings import Sightings, sightings
from solver_backend.io.view_agreement import (
    TOLERANCE_M,
    PeopleInSpace,
    candidates,
    detection_distances,
)
from solver_backend.io.view_tracks import view_tracks
from solver_backend.progress import Progress, silent
from solver_backend.types import Cameras, Keypoints2D

REACH_S = 0.25
"""A person whom fewer than two views agree on is expected where they were, and will be, within this time."""
SEPARATE_M = 0.3
"""Two people in space whose common keypoints are this far apart are different people."""

USUAL_TIMES = 4.0
"""A detection further off than this many times the median is not the person ..."""
CLOSEST_M = 0.04
"""... but nearer than this it may always be."""
AGREEING_SHARE = 0.65
"""Fewer agreeing views than this share of those that see somebody are a problem."""
ALONE_SHARE, STRANGE_SHARE = 0.95, 0.2
"""A view that sees one person in so many frames, accepted in fewer than so many, is itself in doubt."""
TRUSTED_SHARE = 0.5
"""Share of a view's track that must be the person for any of it to be ..."""
SURE_SHARE = 0.8
"""... and share from which detections that are further off than usual are believed too."""


@dataclass(frozen=True)
class SelectedPerson:
    """The detections of one person in every view."""

    keypoints: Keypoints2D
    """Detections of the person."""
    detection: np.ndarray
    """(C, F) which detection is the person; -1 = none. Parts of a person that was detected in pieces are merged."""
    notes: tuple[str, ...] = ()
    """Who was chosen and what was left out."""
    problems: tuple[str, ...] = ()
    """What the user should know."""


def select_person(cameras: Cameras, detections: Detections, fps: float, progress: Progress = silent) -> SelectedPerson:
    """Return the person whom most views agree on over the take.

    In each frame the detections of all views are grouped into people in space; these are tracked, and the person with
    the most agreement is kept. Detections of anybody else are dropped, wherever they stand in the files and however
    large or certain they are.

    Args:
        cameras: C cameras in the order of the detections' views.
        detections: everybody in every view.
        fps: frames per second.
        progress: told how many frames were compared.

    Raises:
        NoDetections: nobody is detected, or no two views agree on anybody.
        TooFewViews: fewer than two views hold detections.
    """
    _require_two_views(detections)
    seen = sightings(cameras, detections)
    tracks = view_tracks(seen)
    blocks: list[PeopleInSpace] = []
    for done, block in candidates(seen):
        blocks.append(block)
        progress("Comparing the views", done, detections.num_frames)
    people = settled(concatenated(blocks), tracks)
    found = persons(people, tracks, fps)
    if not found:
        raise NoDetections(
            f"No two views agree on anybody: no detections of two cameras meet within {TOLERANCE_M} m.",
            where=", ".join(cameras.names),
            hint="Check that calibration and recording belong together, its unit, and that cameras are synchronised.",
        )
    points, near = _expected_points(people, found[0], detections.num_frames, fps)
    others = _claimed_by_others(people, found[0], points, detections)
    accepted, fit = _accepted(seen, points, near, others, tracks)
    strange = _strange_views(detections, accepted)
    accepted[strange] = detections.confidence[strange].any(-1)
    xy, confidence, detection = _merged(detections, accepted, fit)
    notes, problems = _report(cameras, detections, people, found, accepted)
    problems += tuple(
        f"Camera {cameras.names[c]} sees one person, but never where the other cameras do: it may be turned, mirrored, "
        "late or named like another."
        for c in strange
    )
    keypoints = Keypoints2D(xy, confidence, detections.joint_set, fps)
    return SelectedPerson(keypoints, detection, notes, problems)


def _require_two_views(detections: Detections) -> None:
    with_people = (detections.people() > 0).any(axis=1)
    if not with_people.any():
        raise NoDetections(
            "Every confidence is zero: nobody was detected.", hint="Run the detector again or choose other files."
        )
    if with_people.sum() < 2:
        names = ", ".join(np.array(detections.cameras)[with_people])
        raise TooFewViews(
            f"Only {names} of {len(detections.cameras)} cameras has detections; two are needed.",
            hint="Add the detections of another camera.",
        )


def _expected_points(people: PeopleInSpace, rows: np.ndarray, frames: int, fps: float) -> tuple[np.ndarray, np.ndarray]:
    """Return where the person's keypoints are, (F, J, 3) interpolated in time, and (F,) where that is known."""
    known_frames = people.frame[rows]
    every = np.arange(frames)
    points = np.full((frames, *people.points.shape[1:]), np.nan)
    for j in range(points.shape[1]):
        good = np.isfinite(people.points[rows, j, 0])
        at = known_frames[good]
        if not len(at):
            continue
        after = np.clip(np.searchsorted(at, every), 0, len(at) - 1)
        before = np.maximum(after - 1, 0)
        distance = np.minimum(np.abs(at[after] - every), np.abs(at[before] - every))
        track = np.stack([np.interp(every, at, people.points[rows[good], j, axis]) for axis in range(3)], axis=-1)
        points[:, j] = np.where((distance <= REACH_S * fps)[:, None], track, np.nan)
    return points, np.isfinite(points[..., 0]).any(axis=1)


def _claimed_by_others(
    people: PeopleInSpace, rows: np.ndarray, points: np.ndarray, detections: Detections
) -> np.ndarray:
    """Return (C, F, P) whether a detection belongs to people in space who stand apart from the person."""
    claimed = np.zeros(detections.confidence.shape[:3], bool)
    other = np.setdiff1d(np.arange(len(people.frame)), rows)
    apart = np.linalg.norm(people.points[other] - points[people.frame[other]], axis=-1)
    common = np.isfinite(apart)
    mean = np.where(common, apart, 0.0).sum(1) / np.maximum(common.sum(1), 1)
    for row in other[(mean > SEPARATE_M) | ~common.any(1)]:
        views = np.flatnonzero(people.members[row] >= 0)
        claimed[views, people.frame[row], people.members[row, views]] = True
    return claimed


def _accepted(
    seen: Sightings, points: np.ndarray, near: np.ndarray, others: np.ndarray, tracks: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return (C, F, P) which detections are the person, and how many keypoints each has where expected.

    A detection is the person if its keypoints lie where the person's are, as closely as is usual in this recording,
    and if that holds for most of the view's own track it belongs to: someone who passes behind the person keeps their
    track, and is told by the rest of it.
    """
    frames = np.flatnonzero(near)
    distance, fit = np.full(others.shape, np.inf), np.zeros(others.shape)
    for c in range(len(seen.cameras)):
        fit[c, frames], distance[c, frames], _ = detection_distances(seen, c, frames, points[frames])
    usual = distance.min(axis=-1)
    usual = usual[usual < TOLERANCE_M]
    tolerance = min(TOLERANCE_M, max(CLOSEST_M, USUAL_TIMES * float(np.median(usual)))) if usual.size else 0.0
    close = (distance < tolerance) & ~others
    judged = (tracks >= 0) & near[None, :, None]
    size = int(tracks.max()) + 1
    seen_often = np.bincount(tracks[judged], minlength=size)
    right_often = np.bincount(tracks[judged], weights=close[judged].astype(float), minlength=size)
    share = np.where(tracks >= 0, (right_often / np.maximum(seen_often, 1))[np.maximum(tracks, 0)], 0.0)
    accepted = (close & (share >= TRUSTED_SHARE)) | ((distance < TOLERANCE_M) & ~others & (share >= SURE_SHARE))
    return accepted, fit


def _strange_views(detections: Detections, accepted: np.ndarray) -> np.ndarray:
    """Return the views that see one person alone, who is hardly ever accepted: kept, so that the view is examined."""
    people = detections.people()
    seen = (people > 0).sum(1)
    alone = (people == 1).sum(1) >= ALONE_SHARE * seen
    hardly = accepted.any(-1).sum(1) < STRANGE_SHARE * seen
    return np.flatnonzero(alone & hardly & (seen > 0)) if len(people) > 2 else np.zeros(0, int)


def _merged(detections: Detections, accepted: np.ndarray, fit: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return xy (C, F, K, 2) and confidence (C, F, K) of the person, and the detection (C, F) most of it is from.

    A detector may find one person in two pieces (legs here, trunk there): the best-fitting piece comes first, and what
    it lacks is taken from the next.
    """
    order = np.argsort(np.where(accepted, -fit, np.inf), axis=-1, kind="stable")
    shape = (*detections.confidence.shape[:2], detections.confidence.shape[3])
    xy, confidence = np.full((*shape, 2), np.nan), np.zeros(shape)
    views, frames = np.indices(order.shape[:2])
    for place in range(order.shape[2]):
        slot = order[..., place]
        used = accepted[views, frames, slot]
        piece = detections.confidence[views, frames, slot]
        fill = used[..., None] & (confidence == 0) & (piece > 0)
        confidence = np.where(fill, piece, confidence)
        xy = np.where(fill[..., None], detections.xy[views, frames, slot], xy)
    return xy, confidence, np.where(accepted.any(-1), order[..., 0], -1)


def _report(
    cameras: Cameras, detections: Detections, people: PeopleInSpace, found: list[np.ndarray], accepted: np.ndarray
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    frames = detections.num_frames
    views = (people.members[found[0]] >= 0).sum(1)
    notes = [
        f"The person is the one most views agree on: {views.mean():.1f} of {len(cameras)} views, "
        f"in {len(np.unique(people.frame[found[0]]))} of {frames} frames."
    ]
    problems: list[str] = []
    dropped = detections.people() - accepted.sum(-1)
    if dropped.any():
        listing = ", ".join(
            f"{name} in {int((count > 0).sum())} frames"
            for name, count in zip(cameras.names, dropped, strict=True)
            if count.any()
        )
        notes.append(f"Other people are left out: {listing}.")
    with_somebody = (detections.people()[:, people.frame[found[0]]] > 0).sum(0)
    if views.mean() < AGREEING_SHARE * with_somebody.mean():
        problems.append(
            f"Of {with_somebody.mean():.1f} views that see somebody only {views.mean():.1f} agree on the person: "
            "is this the recording's calibration, are the cameras synchronised?"
        )
    for rows in found[1:]:
        other = (people.members[rows] >= 0).sum(1)
        if len(rows) >= 0.5 * len(found[0]) and other.mean() > views.mean() - 0.5:
            problems.append(
                f"Another person is seen as well: {other.mean():.1f} views in {len(rows)} frames. Only one is solved."
            )
    return tuple(notes), tuple(problems)
