"""Select the detections of each person in every view."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.agreement.detections import Detections, Sightings, sightings
from solver_backend.agreement.person_tracks import assigned_exclusively, concatenated, persons, view_tracks
from solver_backend.agreement.view_agreement import TOLERANCE_M, PeopleInSpace, candidates, detection_distances
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.errors import NoDetections, TooFewViews
from solver_backend.exchange.progress import Progress, silent
from solver_backend.types import Cameras, Keypoints2D

REACH_S = 0.25  # Time within which a person is interpolated if fewer than two views agree.
SEPARATE_M = 0.3  # Distance of common keypoints that separates two people.
USUAL_TIMES = 4.0  # Largest distance of a person's detection, in medians.
CLOSEST_M = 0.04  # Distance that always suffices.
ALONE_SHARE, STRANGE_SHARE = 0.95, 0.2
"""Share of frames with one person, and share accepted among them, of a doubtful view."""
TRUSTED_SHARE = 0.5  # Least share of a view's track that is the person.
SURE_SHARE = 0.8  # Share from which unusually distant detections of a track count, too.


@dataclass(frozen=True)
class FollowedPeople:
    """Everybody in space, followed over the take."""

    seen: Sightings  # All detections, without lens distortion.
    tracks: np.ndarray  # (C, F, P) number of the view's own track each detection belongs to.
    people: PeopleInSpace  # Everybody in space.
    rows: list[np.ndarray]  # The rows of ``people`` of each person, the most agreed on first.


@dataclass(frozen=True)
class FoundPerson:
    """The person among all people's detections."""

    people: PeopleInSpace  # Everybody in space.
    rows: list[np.ndarray]  # The rows of ``people`` of each person, the chosen one first.
    accepted: np.ndarray  # (C, F, P) whether a detection is the person.
    fit: np.ndarray  # (C, F, P) how many keypoints of each lie where the person's are expected.


def find_person(cameras: Cameras, detections: Detections, fps: float, progress: Progress = silent) -> FoundPerson:
    """Find the person that most views agree on over the take.

    In each frame the detections of all views are grouped into people in space; these are tracked, and the person with
    the most agreement is chosen.

    Args:
        cameras: C cameras in the order of the detections' views.
        detections: all people in every view.
        fps: frames per second.
        progress: called with how many frames were compared.

    Raises:
        NoDetections, TooFewViews: see ``select_person``.
    """
    followed = follow_people(cameras, detections, fps, progress)
    accepted, fit = detections_of(followed, 0, detections, fps)
    return FoundPerson(followed.people, followed.rows, accepted, fit)


def follow_people(cameras: Cameras, detections: Detections, fps: float, progress: Progress = silent) -> FollowedPeople:
    """Group the detections of all views into people in space, frame by frame, and follow these over the take.

    Args and raises: those of ``find_person``.
    """
    _require_two_views(detections)
    seen = sightings(cameras, detections)
    tracks = view_tracks(seen)
    blocks: list[PeopleInSpace] = []
    for done, block in candidates(seen):
        blocks.append(block)
        progress("Comparing the views", done, detections.num_frames)
    people = assigned_exclusively(concatenated(blocks), tracks)
    found = persons(people, tracks, fps)
    if not found:
        raise NoDetections(
            f"No two views agree on anybody: no detections of two cameras meet within {TOLERANCE_M} m.",
            where=", ".join(cameras.names),
            hint="Check that calibration and recording belong together, which camera has which name, its unit, "
            "and that cameras are synchronised.",
        )
    return FollowedPeople(seen, tracks, people, found)


def detections_of(
    followed: FollowedPeople, person: int, detections: Detections, fps: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return (C, F, P) bool of a person's detections, and the number of matching keypoints of each.

    Args:
        followed: everybody.
        person: index into ``followed.rows``.
        detections: all people in every view.
        fps: frames per second.
    """
    rows = followed.rows[person]
    points, near = _expected_points(followed.people, rows, detections.num_frames, fps)
    others = _claimed_by_others(followed.people, rows, points, detections)
    return _accepted(followed.seen, points, near, others, followed.tracks)


def doubtful_views(detections: Detections, accepted: np.ndarray) -> np.ndarray:
    """Return the views with one person who is rarely accepted."""
    people = detections.people()
    seen = (people > 0).sum(1)
    alone = (people == 1).sum(1) >= ALONE_SHARE * seen
    hardly = accepted.any(-1).sum(1) < STRANGE_SHARE * seen
    return np.flatnonzero(alone & hardly & (seen > 0)) if len(people) > 2 else np.zeros(0, int)


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
    """Return the person's keypoints (F, J, 3), interpolated in time, and (F,) bool of known frames."""
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
    """Return (C, F, P) bool of detections of people apart from the person."""
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
    """Return (C, F, P) bool of the person's detections, and the number of matching keypoints of each.

    A detection is the person if its keypoints are as near as usual in this recording, and if most of its track in the
    view is. People who pass behind the person are known by the rest of their track.
    """
    frames = np.flatnonzero(near)
    distance, fit = np.full(others.shape, np.inf), np.zeros(others.shape)
    for c in range(len(seen.cameras)):
        fit[c, frames], distance[c, frames], _ = detection_distances(seen, c, frames, points[frames])
    usual = distance.min(axis=-1)
    usual = usual[usual < TOLERANCE_M]
    tolerance = min(TOLERANCE_M, max(CLOSEST_M, USUAL_TIMES * float(np.median(usual)))) if usual.size else 0.0
    close = (distance < tolerance) & ~others
    counted = (tracks >= 0) & near[None, :, None]
    size = int(tracks.max()) + 1
    seen_often = np.bincount(tracks[counted], minlength=size)
    right_often = np.bincount(tracks[counted], weights=close[counted].astype(float), minlength=size)
    share = np.where(tracks >= 0, (right_often / np.maximum(seen_often, 1))[np.maximum(tracks, 0)], 0.0)
    accepted = (close & (share >= TRUSTED_SHARE)) | ((distance < TOLERANCE_M) & ~others & (share >= SURE_SHARE))
    return accepted, fit


LEAST_S = 0.5  # Least time of a listed person, or half of a shorter take.
LEAST_AGREEMENT = 0.4
"""Least mean of 1 - distance / tolerance over a person's views. Rays of different people meet by chance, less well."""
USUAL_NAME = "Person {}"  # Default names of people, by the number of views and frames that agree on them.


@dataclass(frozen=True)
class SeenPerson:
    """One of the people in a recording."""

    name: str  # Name of the person.
    accepted: np.ndarray  # (C, F, P) bool of the person's own detections.
    fit: np.ndarray  # (C, F, P) number of matching keypoints.
    rows: np.ndarray  # Rows of the people in space.


def everybody_seen(followed: FollowedPeople, detections: Detections, fps: float) -> tuple[SeenPerson, ...]:
    """Return everybody that two or more views see for long enough, the most agreed on first.

    A detection near two people goes to the one that it fits better.

    Args:
        followed: people followed through space, see ``follow_people``; the first is always among those returned.
        detections: all people in every view.
        fps: frames per second.
    """
    least = min(LEAST_S * fps, 0.5 * detections.num_frames)
    kept = [i for i, rows in enumerate(followed.rows) if i == 0 or _is_somebody(followed, rows, least)]
    found = [detections_of(followed, i, detections, fps) for i in kept]
    fit = np.stack([np.where(accepted, fit, -1.0) for accepted, fit in found])
    best = fit.argmax(axis=0)
    return tuple(
        SeenPerson(USUAL_NAME.format(n + 1), accepted & (best == n), found[n][1], followed.rows[i])
        for n, (i, (accepted, _)) in enumerate(zip(kept, found, strict=True))
    )


def _is_somebody(followed: FollowedPeople, rows: np.ndarray, least: float) -> bool:
    views = (followed.people.members[rows] >= 0).sum(1)
    return len(rows) >= least and float((followed.people.score[rows] / views).mean()) >= LEAST_AGREEMENT


AGREEING_SHARE = 0.65  # Least share of agreeing views among views that see a person.


@dataclass(frozen=True)
class SelectedPerson:
    """The detections of one person in every view."""

    name: str
    """Name of the person."""
    keypoints: Keypoints2D
    """Detections of the person."""
    detection: np.ndarray
    """(C, F) index of the person's detection, -1 without one. A person detected in pieces is merged."""
    notes: tuple[Diagnostic, ...] = ()
    """The chosen person and excluded detections."""
    problems: tuple[Diagnostic, ...] = ()
    """Warnings for the user."""


def select_person(cameras: Cameras, detections: Detections, fps: float, progress: Progress = silent) -> SelectedPerson:
    """Return the person that most views agree on over the take.

    Detections of other people are dropped. A view that never shows two people at once is kept: the checks before a
    solve need all of its detections to find other faults.

    Args: those of ``find_person``.

    Raises:
        NoDetections: no person is detected, or no two views agree on anybody.
        TooFewViews: fewer than two views hold detections.
    """
    return select_people(cameras, detections, fps, progress)[0]


def select_people(
    cameras: Cameras, detections: Detections, fps: float, progress: Progress = silent
) -> tuple[SelectedPerson, ...]:
    """Return everybody that two or more views see, each with their own detections; the most agreed on first.

    Which of them is solved is chosen later. Notes and problems are reported with the first, who is solved where
    nobody chooses. Views that never show two people at once are the first's but where they show another, see
    ``select_person``.

    Args and raises: those of ``select_person``.
    """
    followed = follow_people(cameras, detections, fps, progress)
    people = everybody_seen(followed, detections, fps)
    nobody = np.zeros(detections.confidence.shape[:3], bool)
    others = np.any([nobody, *(person.accepted for person in people[1:])], axis=0)
    first: np.ndarray = people[0].accepted | (_alone(detections) & ~others)
    notes, problems = _report(cameras, detections, followed, people, first)
    problems += tuple(
        diagnostic("camera_sees_elsewhere", cameras=[cameras.names[c]])
        for c in doubtful_views(detections, people[0].accepted | others)
    )
    selected: list[SelectedPerson] = []
    for person in people:
        xy, confidence, hands, detection = _merged(detections, first if not selected else person.accepted, person.fit)
        keypoints = Keypoints2D(xy, confidence, detections.joint_set, fps, hands, detections.own)
        messages = ((), ()) if selected else (notes, problems)
        selected.append(SelectedPerson(person.name, keypoints, detection, *messages))
    return tuple(selected)


def _alone(detections: Detections) -> np.ndarray:
    """Return (C, F, P) bool of detections in views with one person at a time, with three views or more."""
    people = detections.people()
    single = (people.max(axis=1) == 1) & (len(people) > 2)
    return (detections.confidence > 0).any(-1) & single[:, None, None]


def _merged(
    detections: Detections, accepted: np.ndarray, fit: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None, np.ndarray]:
    """Return xy (C, F, K, 2), confidence (C, F, K) and hands of the person, and the (C, F) detection most are from.

    A detector may find one person in two pieces. The best-fitting piece is completed by the next.
    """
    order = np.argsort(np.where(accepted, -fit, np.inf), axis=-1, kind="stable")
    shape = (*detections.confidence.shape[:2], detections.confidence.shape[3])
    xy, confidence = np.full((*shape, 2), np.nan), np.zeros(shape)
    views, frames = np.indices(order.shape[:2])
    hands = None if detections.hands is None else np.full((*order.shape[:2], *detections.hands.shape[3:]), np.nan)
    for place in range(order.shape[2]):
        slot = order[..., place]
        used = accepted[views, frames, slot]
        piece = detections.confidence[views, frames, slot]
        fill = used[..., None] & (confidence == 0) & (piece > 0)
        confidence = np.where(fill, piece, confidence)
        xy = np.where(fill[..., None], detections.xy[views, frames, slot], xy)
        if hands is not None and detections.hands is not None:
            free = used[..., None] & ~(hands[..., 2] > 0).any(axis=-1)  # a hand is of one piece
            hands = np.where(free[..., None, None], detections.hands[views, frames, slot], hands)
    return xy, confidence, hands, np.where(accepted.any(-1), order[..., 0], -1)


def _report(
    cameras: Cameras,
    detections: Detections,
    followed: FollowedPeople,
    people: tuple[SeenPerson, ...],
    accepted: np.ndarray,
) -> tuple[tuple[Diagnostic, ...], tuple[Diagnostic, ...]]:
    """Report the chosen person, other people, and doubts about the first."""
    space, person = followed.people, people[0]
    views = (space.members[person.rows] >= 0).sum(1)
    notes = [
        diagnostic(
            "person_chosen",
            basis="views",
            views=float(views.mean()),
            cameras_count=len(cameras),
            seen=len(np.unique(space.frame[person.rows])),
            of=detections.num_frames,
        )
    ]
    problems: list[Diagnostic] = []
    dropped = detections.people() - accepted.sum(-1)
    if dropped.any():
        shares = [
            f"{name} in {int((count > 0).sum())} frames"
            for name, count in zip(cameras.names, dropped, strict=True)
            if count.any()
        ]
        notes.append(diagnostic("people_left_out", shares=shares))
    notes += [
        diagnostic(
            "person_seen_too",
            person=other.name,
            views=float((space.members[other.rows] >= 0).sum(1).mean()),
            seen=len(other.rows),
        )
        for other in people[1:]
    ]
    with_somebody = (detections.people()[:, space.frame[person.rows]] > 0).sum(0)
    if views.mean() < AGREEING_SHARE * with_somebody.mean():
        problems.append(diagnostic("few_views_agree", views=float(with_somebody.mean()), agreeing=float(views.mean())))
    return tuple(notes), tuple(problems)
