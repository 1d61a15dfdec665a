"""Whether the markers can be of one body: no two halves that stand apart."""

from __future__ import annotations

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.landmark_set import Landmarks
from solver_backend.exchange.diagnostics.wording import listed
from solver_backend.exchange.errors import MarkersUnknown
from solver_backend.geometry.quantiles import quantile

FRAMES = 60
"""Frames at most in which distances are measured."""
LEAST_GROUP = 3
"""Markers of a group that is more than wrong labels; those are found by the fit."""
LARGEST, SLACK_M = 1.45, 0.15
"""How much larger than the average body a person is at most (2.45 m), and by how much more markers are off their
places: real bodies' nearest places come no nearer to this than half, two halves 0.6 m apart exceed it."""
NEAREST = 5
"""Pairs across the gap by which it is tested: those that are nearest on a body."""


def check_one_body(points: np.ndarray, landmarks: Landmarks, body: Body, offsets: np.ndarray | float = 0.0) -> None:
    """Make sure that the markers are not two groups that are farther apart than a body reaches.

    The groups are those that the longest edge of the minimum spanning tree of the median distances parts. They are of
    different bodies if each of the pairs across that are nearest along the skeleton, d, is farther apart than
    ``LARGEST d + SLACK_M``.

    Args:
        points: (F, L, 3) metres, NaN where missing.
        landmarks: the L places.
        body: of average shape.
        offsets: (L, 3) metres of the markers from their places in the rest frame: those on a bone are at its joint.

    Raises:
        MarkersUnknown: they are.
    """
    some = points[np.unique(np.linspace(0, len(points) - 1, FRAMES).astype(int))]
    distance = quantile(np.linalg.norm(some[:, :, None] - some[:, None], axis=-1), 0.5, axis=0)
    known = np.flatnonzero(np.isfinite(distance).sum(axis=1) > LEAST_GROUP)
    if len(known) < 2 * LEAST_GROUP:
        return
    between = np.where(np.isfinite(distance), distance, np.inf)[np.ix_(known, known)]
    parts = _parted(between)
    if min(parts.sum(), (~parts).sum()) < LEAST_GROUP:
        return
    along = _along_skeleton(landmarks, body, offsets)[np.ix_(known, known)][parts][:, ~parts].ravel()
    apart = between[parts][:, ~parts].ravel()
    nearest = np.argsort(along, kind="stable")[:NEAREST]
    if (apart[nearest] > LARGEST * along[nearest] + SLACK_M).all():
        one, two = ([landmarks.names[m] for m in known[which]] for which in (parts, ~parts))
        raise MarkersUnknown(
            f"The markers are two groups {apart.min():.2f} m apart, farther than on one body: {listed(one)} and "
            f"{listed(two)}.", where="markers",
            hint="They are of two people or things: give each a prefix of its own, or leave one out with `layout`.",
        )  # fmt: skip


def _parted(distance: np.ndarray) -> np.ndarray:
    """Return (M,) bool: one side of the longest edge of the minimum spanning tree (Prim 1957)."""
    count = len(distance)
    parent, away = np.zeros(count, dtype=int), distance[0].copy()
    inside = np.arange(count) == 0
    length = np.zeros(count)
    order = []
    for _ in range(count - 1):
        added = int(np.argmin(np.where(inside, np.inf, away)))
        inside[added], length[added] = True, away[added]
        order.append(added)
        nearer = distance[added] < away
        parent, away = np.where(nearer & ~inside, added, parent), np.minimum(away, distance[added])
    beyond = np.arange(count) == int(np.argmax(length))
    for added in order:  # what was joined to it later is beyond too
        beyond[added] |= bool(beyond[parent[added]])
    return beyond


def _along_skeleton(landmarks: Landmarks, body: Body, offsets: np.ndarray | float) -> np.ndarray:
    """Return (L, L) metres from place to place along the skeleton: to the joint, the way from joint to joint, back."""
    places, carriers = landmarks.anchors.sum(axis=1) + offsets, np.argmax(landmarks.weights, axis=1)
    joints, parents = body.joints_template, body.parents
    way = np.zeros((len(joints), len(joints)))
    for j, p in enumerate(parents):
        if p >= 0:
            way[j, :j] = way[p, :j] + np.linalg.norm(joints[j] - joints[p])
            way[:j, j] = way[j, :j]
    out = np.linalg.norm(places - joints[carriers], axis=-1)
    return way[np.ix_(carriers, carriers)] + out[:, None] + out
