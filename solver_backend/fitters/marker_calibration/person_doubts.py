"""Report warnings about a person's markers from before and during calibration."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.joint_names import is_joint_centre
from solver_backend.body.landmarks import Landmarks
from solver_backend.body.markers import ON_BONE
from solver_backend.exchange.diagnostics import Diagnostic, Remedy, diagnostic, listed
from solver_backend.exchange.errors import MarkersUnknown
from solver_backend.geometry.arrays import quantile
from solver_backend.labelling.label_like import NameChange
from solver_backend.types import MarkerCloud, MarkerSubject

MISPLACED, TWO_PLACES, EXCHANGED = "misplaced", "two_places", "exchanged"
"""Keys in a person's provenance: unused names (``label``, ``place``, ``off_m``), labels at two positions (``label``,
``apart_m``, ``take`` and ``other`` from 1), and pairs of swapped labels."""
NAMES_OVER_TAKES, SIDE_FOUND = "names_over_takes", "side_found"
"""Keys for swapped names (``take`` from 1, ``labels``, ``corrected``) and sideless labels (``label``, ``place``)."""


def doubts_of(person: MarkerSubject) -> list[Diagnostic]:
    """Return warnings about a calibrated person, for example names that differ between takes or misplaced markers."""
    sides, over, off, two = (
        person.provenance.get(key, ()) for key in (SIDE_FOUND, NAMES_OVER_TAKES, MISPLACED, TWO_PLACES)
    )
    found: list[Diagnostic] = []

    def add(code: str, rows: Sequence[dict[str, Any]], **values: Any) -> None:
        labels = [label for row in rows for label in row.get("labels", [row.get("label")])]
        found.extend([diagnostic(code, markers=labels, **values)] if rows else [])

    add("limb_side_found", sides, basis="place", side="right" if sides and sides[0]["place"][0] == "R" else "left")
    for code, wanted in (("names_exchanged_in_takes", True), ("names_differ_between_takes", False)):
        rows = [row for row in over if row["corrected"] is wanted]
        texts = [f"{' and '.join(row['labels'])} in take {row['take']}" for row in rows]
        add(code, rows, places=", ".join(texts))
    named = sum(not place.startswith(ON_BONE) for place in person.places) + len(off)
    if 2 * len(off) >= named:
        add("markers_of_nobody", off, count=len(off), named=named)
    else:
        texts = [f"{row['label']} as {row['place']} ({1000 * row['off_m']:.0f} mm)" for row in off]
        add("markers_off_place", off, places=", ".join(texts))
    texts = [
        f"{row['label']} by {1000 * row['apart_m']:.0f} mm between takes {row['take']} and {row['other']}"
        for row in two
    ]
    add("marker_in_two_places", two, places=", ".join(texts))
    return found


def over_takes(changes: Sequence[NameChange]) -> dict[str, Any]:
    """Return the provenance entry for names that were swapped in single takes."""
    rows = [
        {"take": c.take + 1, "labels": [label for label in (c.first, c.second) if label], "corrected": c.mended}
        for c in changes
    ]
    return {NAMES_OVER_TAKES: rows} if rows else {}


def exchanged_in(person: MarkerSubject) -> list[Diagnostic]:
    """Return a warning for each pair of labels that the calibration swapped. A solve also reports the frames."""
    pairs = person.provenance.get(EXCHANGED, ())
    return [diagnostic("markers_exchanged", markers=sorted(pair), remedy=Remedy.REPAIRED) for pair in pairs]


WIDEST = 0.64
"""Largest distance between the hips relative to the thigh's length. It is 0.40 in an inertial suit's skeleton, 0.3 to
0.45 in bodies and 0.52 in detections. Markers on the outer hip or the waist reach 0.7 and more."""
FAR_M = 0.025  # Smallest error of a wrong joint centre. Inertial suits have 11 mm, skin markers 40 mm.
STRANGE = 4.0  # Smallest implausible shape coefficient. A suit reaches 1.3, markers named as hips and knees 6.5.
_CHAIN = ("hip", "knee", "ankle", "shoulder", "elbow", "wrist")


def doubt_joints(cloud: MarkerCloud, person: MarkerSubject) -> list[Diagnostic]:
    """Return a warning if points with joint names are not joint centres."""
    if not any(is_joint_centre(place) for place in person.places):
        return []
    chain = [m for m, place in enumerate(person.places) if is_joint_centre(place) and place.endswith(_CHAIN)]
    off = np.linalg.norm(person.offsets[chain], axis=-1)
    far = [person.labels[m] for m, distance in zip(chain, off, strict=True) if distance > FAR_M]
    wide, shape = _width(cloud, person), float(np.abs(person.betas).max())
    if wide <= WIDEST and 2 * len(far) < len(chain) and (shape <= STRANGE or not far):
        return []
    most = 1000 * float(off.max(initial=0.0))
    return [diagnostic("joints_doubted", markers=far, size=100 * wide, off=most, shape=shape)]


def _width(cloud: MarkerCloud, person: MarkerSubject) -> float:
    label_of = {place[1:]: label for place, label in zip(person.places, person.labels, strict=True)}
    needed = [label_of.get(name) for name in ("left_hip", "right_hip", "left_knee", "right_knee")]
    if not all(label in cloud.names for label in needed):
        return 0.0
    left, right, left_knee, right_knee = (cloud.positions[:, cloud.names.index(str(label))] for label in needed)
    thigh = 0.5 * (np.linalg.norm(left_knee - left, axis=-1) + np.linalg.norm(right_knee - right, axis=-1))
    return float(np.nan_to_num(quantile(np.linalg.norm(left - right, axis=-1) / np.maximum(thigh, 1e-9), 0.5, axis=0)))


DISTANCE_FRAMES = 60  # Number of frames in which distances are measured.
LEAST_GROUP, NEAREST = 3, 5  # Smallest number of markers in a group, and number of pairs compared across the gap.
LARGEST, SLACK_M = 1.45, 0.15
"""Largest person relative to the average body, and tolerance in metres. Two halves that are 0.6 m apart exceed it."""


def check_one_body(points: np.ndarray, landmarks: Landmarks, body: Body, offsets: np.ndarray | float = 0.0) -> None:
    """Check that the markers are not two groups that are farther apart than a body can reach.

    The groups are separated at the longest edge of the minimum spanning tree of median distances. Of the marker pairs
    with one marker in each group, those with the smallest distances d along the skeleton are compared. The groups are
    on different bodies if every pair is farther apart than ``LARGEST d + SLACK_M``. ``offsets`` are (L, 3) in metres,
    from the markers' locations in the rest pose of an average body. Markers known only by their bone and without an
    offset are not compared.

    Raises:
        MarkersUnknown: the groups are too far apart.
    """
    some = points[np.unique(np.linspace(0, len(points) - 1, DISTANCE_FRAMES).astype(int))]
    distance = quantile(np.linalg.norm(some[:, :, None] - some[:, None], axis=-1), 0.5, axis=0)
    placed = np.broadcast_to(offsets, landmarks.anchors.shape[::2]).any(axis=-1)
    placed |= [not name.startswith(ON_BONE) for name in landmarks.names]
    known = np.flatnonzero((np.isfinite(distance).sum(axis=1) > LEAST_GROUP) & placed)
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
            f"Two groups of markers are {apart.min():.2f} m apart, too far for one body: {listed(one)} and "
            f"{listed(two)}.",
            where="markers",
            hint="If they are on two people or objects, give each a label prefix, or leave one out with `markers "
            "layout`.",
        )


def _parted(distance: np.ndarray) -> np.ndarray:
    """Return an (M,) mask of the markers on one side of the longest edge of the minimum spanning tree."""
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
    for added in order:  # everything joined to it later is also beyond the edge
        beyond[added] |= bool(beyond[parent[added]])
    return beyond


def _along_skeleton(landmarks: Landmarks, body: Body, offsets: np.ndarray | float) -> np.ndarray:
    places, carriers = landmarks.anchors.sum(axis=1) + offsets, np.argmax(landmarks.weights, axis=1)
    joints, parents = body.joints_template, body.parents
    way = np.zeros((len(joints), len(joints)))
    for j, p in enumerate(parents):
        if p >= 0:
            way[j, :j] = way[p, :j] + np.linalg.norm(joints[j] - joints[p])
            way[:j, j] = way[j, :j]
    out = np.linalg.norm(places - joints[carriers], axis=-1)
    return way[np.ix_(carriers, carriers)] + out[:, None] + out
