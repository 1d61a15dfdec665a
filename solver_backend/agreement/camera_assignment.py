"""Assign calibrated cameras to recorded ones by the agreement of the views, where names do not show it."""

from __future__ import annotations

from itertools import combinations, permutations
from math import perm

import numpy as np

from solver_backend.agreement.detections import Detections
from solver_backend.agreement.evidence import BOUND, TakeEvidence
from solver_backend.agreement.noise import density_per_bin
from solver_backend.agreement.reading import Reading
from solver_backend.types import Cameras

LEAST_CAMERAS = 3  # Two views agree by chance in too many ways: one pair of lines is all there is.
MOST_WAYS = 50_000  # Assignments that are compared: of 8 cameras to 8 there are 40,320.
_POSES, _JUDGED = 20, 20  # Compared poses, and best assignments with an estimated noise.


def assigned_by_views(calibrated: Cameras, detections: Detections, by_order: list[int] | None) -> list[int] | None:
    """Return the calibrated camera of each recorded one by the agreement of views, None if it is not clear.

    Rings of equal cameras can be turned without a difference: then only ``by_order`` may show which is which.

    Args:
        calibrated: A cameras, in any unit.
        detections: of C recorded ones, C from 3 to A.
        by_order: (C,) the assignment that counting the names suggests, None where they do not count.
    """
    count, total = len(detections.cameras), len(calibrated)
    if not LEAST_CAMERAS <= count <= total or perm(total, count) > MOST_WAYS:
        return None
    evidence = TakeEvidence(calibrated, detections)
    if not evidence.poses:
        return None
    evidence = evidence.quick(_POSES)
    ways = np.array(list(permutations(range(total), count)))
    scores = _quick_scores(evidence, ways, total)
    best = ways[np.argsort(-scores, kind="stable")[:_JUDGED]].tolist()
    best += [by_order] if by_order is not None and by_order not in best else []
    readings = [_reading(owners) for owners in best]
    ratios, _ = evidence.likelihoods(readings)
    first = readings[int(ratios.argmax())]
    nats = ratios * evidence.constraints(first) / evidence.design_effect(first)
    if by_order is not None:
        ordered = float(nats[best.index(by_order)])
        if ordered >= BOUND and ordered > nats.max() - BOUND:
            return by_order
    order = np.argsort(-nats)
    clear = nats[order[0]] >= BOUND and (len(order) == 1 or nats[order[0]] - nats[order[1]] >= BOUND)
    return best[order[0]] if clear else None


def _reading(owners: list[int]) -> Reading:
    return Reading(Reading.as_written(len(owners)).pictures, tuple(owners), (False,) * len(owners))


def _quick_scores(evidence: TakeEvidence, ways: np.ndarray, total: int) -> np.ndarray:
    """Return (W,) log-likelihoods of assignments under the usual noise of detectors, pair by pair."""
    scores, usual = np.zeros(len(ways)), density_per_bin(0.02, 0.1)
    pairs = list(permutations(range(total), 2))
    for i, j in combinations(range(evidence.views), 2):
        readings = list[Reading]()
        for a, b in pairs:
            owners = list(range(evidence.views))
            owners[i], owners[j] = a, b
            readings.append(_reading(owners))
        table = np.full((total, total), -np.inf)
        table[tuple(np.array(pairs).T)] = evidence.pair_counts(readings, i, j) @ usual
        scores += table[ways[:, i], ways[:, j]]
    return scores
