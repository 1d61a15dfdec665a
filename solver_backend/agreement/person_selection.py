"""Select the detections of each person in every view."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from solver_backend.agreement.body_evidence import MEAN_STATURE_M
from solver_backend.agreement.evidence import LEAST_NOISE, MATCHING_SHARE, SAMPLED_FRAMES, SIGMAS
from solver_backend.agreement.person_tracks import (
    BRIDGE_S,
    TOLERANCE_M,
    PeopleInSpace,
    assigned_exclusively,
    candidates,
    detection_distances,
    joined_tracks,
    persons,
    ray_directions,
    view_tracks,
)
from solver_backend.agreement.reading import Sightings, extent, sightings
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.errors import NoDetections, TooFewViews
from solver_backend.exchange.progress import Progress, silent
from solver_backend.geometry.arrays import quantile
from solver_backend.geometry.small_matrices import unit
from solver_backend.types import Cameras, Detections, Keypoints2D

USUAL_TIMES = 4.0  # Largest distance of a person's detection relative to the median. With 3.5, 1 % are missed.
CLOSEST_M = 0.04  # Distance of a person's detection that is always accepted, in metres.


@dataclass(frozen=True)
class FollowedPeople:
    """All people in space, tracked over the take."""

    seen: Sightings  # All detections, without lens distortion.
    tracks: np.ndarray  # (C, F, P) number of the view's own track each detection belongs to.
    people: PeopleInSpace  # Everybody in space.
    rows: list[np.ndarray]  # The rows of ``people`` of each person, the most agreed on first.


def follow_people(cameras: Cameras, detections: Detections, fps: float, progress: Progress = silent) -> FollowedPeople:
    """Group the detections of all views into people in space, and track them over the take.

    Raises:
        NoDetections: no person is detected, or no two views agree on a person.
        TooFewViews: fewer than two views have detections.
    """
    _require_two_views(detections)
    seen = sightings(cameras, detections)
    tracks = view_tracks(seen.xy)
    people = assigned_exclusively(candidates(seen, progress), tracks)
    found = persons(people, tracks, fps)
    if not found:
        raise NoDetections(
            f"No two cameras agree on a person's position to within {TOLERANCE_M} m.",
            where=", ".join(cameras.names),
            hint="Check that the calibration belongs to this recording, its unit and camera names, and that the "
            "cameras are synchronised.",
        )
    return FollowedPeople(seen, tracks, people, found)


def detections_of(
    followed: FollowedPeople, person: int, detections: Detections, fps: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return a (C, F, P) mask of a person's detections, and the number of matching keypoints of each detection.

    A detection is accepted if it is as close to the person's 3D keypoints as usual in this recording, and if most of
    its track in the view is. The track distinguishes the person from people who pass behind.
    """
    seen, tracks = followed.seen, followed.tracks
    points, near = _expected_points(followed.people, followed.rows[person], detections.num_frames, fps)
    frames = np.flatnonzero(near)
    distance, fit = np.full(tracks.shape, np.inf), np.zeros(tracks.shape)
    for c in range(len(seen.cameras)):
        fit[c, frames], distance[c, frames], _ = detection_distances(seen, c, frames, points[frames])
    usual = distance.min(axis=-1)
    usual = usual[usual < TOLERANCE_M]
    tolerance = min(TOLERANCE_M, max(CLOSEST_M, USUAL_TIMES * float(np.median(usual)))) if usual.size else 0.0
    close = distance < tolerance
    counted = (tracks >= 0) & near[None, :, None]
    size = int(tracks.max()) + 1
    seen_often = np.bincount(tracks[counted], minlength=size)
    right_often = np.bincount(tracks[counted], weights=close[counted].astype(float), minlength=size)
    share = np.where(tracks >= 0, (right_often / np.maximum(seen_often, 1))[np.maximum(tracks, 0)], 0.0)
    accepted = (close & (share >= 0.5)) | ((distance < TOLERANCE_M) & (share >= MATCHING_SHARE))
    return accepted, fit


def doubtful_views(detections: Detections, accepted: np.ndarray) -> np.ndarray:
    """Return the views that usually show a single person, but rarely an accepted detection."""
    people = detections.people()
    seen = (people > 0).sum(1)
    alone = (people == 1).sum(1) >= MATCHING_SHARE * seen
    hardly = accepted.any(-1).sum(1) < (1 - MATCHING_SHARE) * seen
    return np.flatnonzero(alone & hardly & (seen > 0)) if len(people) > 2 else np.zeros(0, int)


def _require_two_views(detections: Detections) -> None:
    with_people = (detections.people() > 0).any(axis=1)
    if not with_people.any():
        raise NoDetections(
            "All confidences are zero, so no person was detected.", hint="Run the detector again or choose other files."
        )
    if with_people.sum() < 2:
        names = ", ".join(np.array(detections.cameras)[with_people])
        raise TooFewViews(
            f"Of {len(detections.cameras)} cameras, only {names} has detections, but two are needed.",
            hint="Add the detections of another camera.",
        )


def _expected_points(people: PeopleInSpace, rows: np.ndarray, frames: int, fps: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the person's (F, J, 3) keypoints, interpolated in time, and an (F,) mask of known frames."""
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
        points[:, j] = np.where((distance <= 0.5 * BRIDGE_S * fps)[:, None], track, np.nan)
    return points, np.isfinite(points[..., 0]).any(axis=1)


@dataclass(frozen=True)
class SelectedPerson:
    """Detections of one person in every view."""

    name: str  # Name of the person.
    keypoints: Keypoints2D  # Detections of the person.
    detection: np.ndarray
    """(C, F) index of the person's detection, -1 without one. A person detected in pieces is merged."""
    notes: tuple[Diagnostic, ...] = ()  # The chosen person and excluded detections.
    problems: tuple[Diagnostic, ...] = ()  # Warnings for the user.


def select_people(
    cameras: Cameras, detections: Detections, fps: float, progress: Progress = silent
) -> tuple[SelectedPerson, ...]:
    """Return the people whom two views show for long enough, with the best agreement first.

    The rays of another person must meet nearly as closely as the rays of the first one, because people who are each in
    the background of a single view may form a person by chance.

    The person to solve is chosen later. Notes and problems are attached to the first person, who is solved by default.
    A detection near two people is assigned to the better fit. A view that never shows two people is assigned to the
    first person, because later checks need all its detections.

    Args and raises: as in ``follow_people``.
    """
    followed = follow_people(cameras, detections, fps, progress)
    space, least = followed.people, min(BRIDGE_S * fps, 0.5 * detections.num_frames)

    gaps = _gaps(followed, followed.rows[0])
    usual = {pair: np.fmax(quantile(own, 0.75, axis=0), LEAST_NOISE * MEAN_STATURE_M) for pair, own in gaps.items()}
    every = float(np.median(list(usual.values())))

    def is_somebody(rows: np.ndarray) -> bool:
        ratios = [own / usual.get(pair, every) for pair, own in _gaps(followed, rows).items()]
        return bool(quantile(np.concatenate(ratios), 0.75, axis=0) <= SIGMAS)  # a quarter may be joined wrongly

    kept = [i for i, rows in enumerate(followed.rows) if i == 0 or (len(rows) >= least and is_somebody(rows))]
    found = [detections_of(followed, i, detections, fps) for i in kept]
    best = np.stack([np.where(accepted, fit, -1.0) for accepted, fit in found]).argmax(axis=0)
    accepted = [own & (best == n) for n, (own, _) in enumerate(found)]
    left = [n for n, own in enumerate(accepted) if n == 0 or (own.any(-1).sum(0) > 1).sum() >= least]
    kept, found, accepted = [kept[n] for n in left], [found[n] for n in left], [accepted[n] for n in left]
    others = np.any([np.zeros(best.shape, bool), *accepted[1:]], axis=0)
    unsure = doubtful_views(detections, accepted[0] | others)
    people = detections.people()
    alone = (people.max(axis=1) == 1) & (len(people) > 2)  # one person at a time, with three views or more
    accepted[0] = accepted[0] | ((detections.confidence > 0).any(-1) & alone[:, None, None] & ~others)
    notes, problems = _report(cameras, detections, space, [followed.rows[i] for i in kept], accepted[0])
    problems += tuple(diagnostic("camera_sees_elsewhere", cameras=[cameras.names[c]]) for c in unsure)
    return _selected(detections, fps, zip(accepted, (fit for _, fit in found), strict=True), notes, problems)


def _gaps(followed: FollowedPeople, rows: np.ndarray) -> dict[tuple[int, int], np.ndarray]:
    """Return the distances (N,) in metres between a person's rays in two views, for each pair of views.

    The distance in a frame is the median over the keypoints of the signed distances, which noise does not shift.
    """
    rows = rows[:: max(1, len(rows) // SAMPLED_FRAMES)]
    seen, members, frame = followed.seen, followed.people.members[rows], followed.people.frame[rows]
    found = dict[tuple[int, int], np.ndarray]()
    for a, b in combinations(range(len(seen.cameras)), 2):
        both = (members[:, [a, b]] >= 0).all(axis=1)
        one, other = (seen.xy[c, frame[both], members[both, c]] for c in (a, b))
        base, first = seen.cameras.centres[b] - seen.cameras.centres[a], ray_directions(seen.cameras, a, one)
        sides = []
        for points in (other, other[:, seen.mirror]):  # left and right may be swapped
            across = unit(np.cross(first, ray_directions(seen.cameras, b, points)))
            sides.append(np.abs(quantile(across @ base, 0.5, axis=-1)))
        if both.any():
            found[a, b] = np.fmin(*sides)
    return found


def _selected(
    detections: Detections, fps: float, people: Iterable[tuple[np.ndarray, np.ndarray]], notes: tuple[Diagnostic, ...],
    problems: tuple[Diagnostic, ...],
) -> tuple[SelectedPerson, ...]:  # fmt: skip
    selected: list[SelectedPerson] = []
    for number, (accepted, fit) in enumerate(people, 1):
        xy, confidence, hands, detection = _merged(detections, accepted, fit)
        keypoints = Keypoints2D(xy, confidence, detections.joint_set, fps, hands, detections.own)
        messages = ((), ()) if selected else (notes, problems)
        selected.append(SelectedPerson(f"Person {number}", keypoints, detection, *messages))
    return tuple(selected)


def _merged(
    detections: Detections, accepted: np.ndarray, fit: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None, np.ndarray]:
    """Merge a person's detections. Return xy, confidence, hands and the (C, F) index of the main detection.

    A detector may find one person in two pieces. Keypoints that are missing in the best-fitting piece come from the
    next.
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
    cameras: Cameras, detections: Detections, space: PeopleInSpace, people: list[np.ndarray], accepted: np.ndarray
) -> tuple[tuple[Diagnostic, ...], tuple[Diagnostic, ...]]:

    def views_of(rows: np.ndarray) -> float:
        return float((space.members[rows] >= 0).sum(1).mean())

    views, seen = views_of(people[0]), len(np.unique(space.frame[people[0]]))
    chosen = {"views": views, "cameras_count": len(cameras), "seen": seen, "of": detections.num_frames}
    notes, problems = [diagnostic("person_chosen", basis="views", **chosen)], list[Diagnostic]()
    dropped = (detections.people() - accepted.sum(-1)) * (accepted.any(-1).sum(0) > 1)  # one view locates nobody
    if dropped.any():
        counts = zip(cameras.names, (dropped > 0).sum(1), strict=True)
        notes.append(diagnostic("people_left_out", shares=[f"{name} in {n} frames" for name, n in counts if n]))
    for number, rows in enumerate(people[1:], 2):
        figures = {"views": views_of(rows), "seen": len(rows)}
        notes.append(diagnostic("person_seen_too", person=f"Person {number}", **figures))
    with_somebody = float((detections.people()[:, space.frame[people[0]]] > 0).sum(0).mean())
    if 2 * views < with_somebody + 1:  # no majority
        problems.append(diagnostic("few_views_agree", views=with_somebody, agreeing=views))
    return tuple(notes), tuple(problems)


def select_in_one_view(detections: Detections, fps: float) -> tuple[SelectedPerson, ...]:
    """Return the people in one view, ordered by size times duration.

    Raises:
        NoDetections: no person is detected.
    """
    own, count = [point.name for point in detections.own], detections.joint_set.num_keypoints
    xy, confidence = detections.xy[..., :count, :], detections.confidence[..., :count]
    detections = replace(detections, xy=xy, confidence=confidence, own=())
    points = np.where((confidence > 0)[..., None], xy, np.nan)[0]
    tracks = joined_tracks(points, fps)
    shown = tracks >= 0
    if not shown.any():
        where = ", ".join(detections.cameras)
        raise NoDetections("No person was detected.", where=where, hint="Run the detector again.")
    seen, size = np.bincount(tracks[shown]), np.bincount(tracks[shown], extent(points)[shown])
    enough = seen >= (1 - MATCHING_SHARE) * seen.max()  # much shorter tracks are passers-by
    kept = [n for n in np.argsort(-size, kind="stable").tolist() if enough[n] or n == size.argmax()]
    count = int((seen > 0).sum())
    others = [diagnostic("other_tracks", count=count - 1, solvable=len(kept) - 1)] if count > 1 else []
    notes = (diagnostic("person_chosen", basis="largest", seen=int(seen[kept[0]]), of=len(points)), *others)
    problems = (diagnostic("own_point_unused", reason="single", joints=own),) if own else ()
    people = (tracks[None] == n for n in kept)
    return _selected(detections, fps, ((person, person.astype(float)) for person in people), notes, problems)
