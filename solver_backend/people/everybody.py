"""Everybody that two or more views see: their detections in every view, apart from one another."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.people.detections import Detections
from solver_backend.people.person_finding import FollowedPeople, detections_of

LEAST_S = 0.5
"""Somebody that two views agree on for less than this, and for less than half of a shorter take, is not listed."""
LEAST_AGREEMENT = 0.4
"""Mean over a person's views of 1 - distance / tolerance: rays of different people meet by chance, hardly so well."""
USUAL_NAME = "Person {}"
"""What people are called until somebody names them, by the number of views and frames that agree on them."""


@dataclass(frozen=True)
class SeenPerson:
    """One of the people in a recording."""

    name: str
    """What they are called."""
    accepted: np.ndarray
    """(C, F, P) which detections are theirs; no detection is two people's."""
    fit: np.ndarray
    """(C, F, P) how many keypoints of each lie where theirs are expected."""
    rows: np.ndarray
    """Which of the people in space they are."""


def everybody_seen(followed: FollowedPeople, detections: Detections, fps: float) -> tuple[SeenPerson, ...]:
    """Return everybody that two or more views see for long enough, the most agreed on first.

    A detection that lies where two people are expected, as when they embrace, goes to the one that it fits better.

    Args:
        followed: people followed through space, see ``follow_people``; the first is always among those returned.
        detections: everybody in every view.
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
