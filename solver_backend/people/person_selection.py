"""The detections of each person in every view, what was left out, and what is doubtful."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.progress import Progress, silent
from solver_backend.people.detections import Detections
from solver_backend.people.everybody import SeenPerson, everybody_seen
from solver_backend.people.person_finding import FollowedPeople, doubtful_views, follow_people
from solver_backend.types import Cameras, Keypoints2D

AGREEING_SHARE = 0.65
"""Fewer agreeing views than this share of those that see somebody are a problem."""


@dataclass(frozen=True)
class SelectedPerson:
    """The detections of one person in every view."""

    name: str
    """What they are called."""
    keypoints: Keypoints2D
    """Detections of the person."""
    detection: np.ndarray
    """(C, F) which detection is the person; -1 = none. Parts of a person that was detected in pieces are merged."""
    notes: tuple[Diagnostic, ...] = ()
    """Who was chosen and what was left out."""
    problems: tuple[Diagnostic, ...] = ()
    """What the user should know."""


def select_person(cameras: Cameras, detections: Detections, fps: float, progress: Progress = silent) -> SelectedPerson:
    """Return the person that most views agree on over the take.

    Detections of anybody else are dropped, wherever they stand in the files and however large or certain they are. A
    view that never shows two people at once is kept as it is: whether it is rotated, mirrored, late, named like another
    or shows somebody else for a while is found out before a solve, by all of its detections.

    Args: those of ``find_person``.

    Raises:
        NoDetections: nobody is detected, or no two views agree on anybody.
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
    """Return (C, F, P) the detections of views that show one person at a time, of three views or more."""
    people = detections.people()
    single = (people.max(axis=1) == 1) & (len(people) > 2)
    return (detections.confidence > 0).any(-1) & single[:, None, None]


def _merged(
    detections: Detections, accepted: np.ndarray, fit: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None, np.ndarray]:
    """Return xy (C, F, K, 2), confidence (C, F, K) and hands of the person, and the (C, F) detection most are from.

    A detector may find one person in two pieces (legs here, trunk there): the best-fitting piece comes first, and what
    it lacks is taken from the next.
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
    """Return who was found, and who else; and what is doubtful about the first."""
    space, person = followed.people, people[0]
    views = (space.members[person.rows] >= 0).sum(1)
    notes = [
        diagnostic(
            "person_chosen",
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
