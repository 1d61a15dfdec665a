"""Choose the person to solve: their detections in every view, what was left out, and what is doubtful."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.exchange.progress import Progress, silent
from solver_backend.people.detections import Detections
from solver_backend.people.person_finding import FoundPerson, doubtful_views, find_person
from solver_backend.types import Cameras, Keypoints2D

AGREEING_SHARE = 0.65
"""Fewer agreeing views than this share of those that see somebody are a problem."""


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

    Detections of anybody else are dropped, wherever they stand in the files and however large or certain they are. A
    view that never shows two people at once is kept as it is: whether it is rotated, mirrored, late, named like another
    or shows somebody else for a while is found out before a solve, by all of its detections.

    Args: those of ``find_person``.

    Raises:
        NoDetections: nobody is detected, or no two views agree on anybody.
        TooFewViews: fewer than two views hold detections.
    """
    found = find_person(cameras, detections, fps, progress)
    accepted = found.accepted | _alone(detections)
    notes, problems = _report(cameras, detections, found, accepted)
    problems += tuple(
        f"Camera {cameras.names[c]} sees one person, but never where the other cameras do: it may be turned, mirrored, "
        "late or named like another."
        for c in doubtful_views(detections, found.accepted)
    )
    xy, confidence, detection = _merged(detections, accepted, found.fit)
    keypoints = Keypoints2D(xy, confidence, detections.joint_set, fps)
    return SelectedPerson(keypoints, detection, notes, problems)


def _alone(detections: Detections) -> np.ndarray:
    """Return (C, F, P) the detections of views that show one person at a time, of three views or more."""
    people = detections.people()
    single = (people.max(axis=1) == 1) & (len(people) > 2)
    return (detections.confidence > 0).any(-1) & single[:, None, None]


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
    cameras: Cameras, detections: Detections, person: FoundPerson, accepted: np.ndarray
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    frames, people, found = detections.num_frames, person.people, person.rows
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
