"""Label takes that have too few marker names before they are solved."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from solver_backend.body.marker_names import (
    LEAST_MARKERS,
    LEAST_NETWORK_PLACES,
    MarkerNames,
    is_unnamed,
    least_markers,
    name_markers,
    places_by_side,
)
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.errors import FileMissing, MarkersUnknown, NoDetections
from solver_backend.exchange.progress import Progress, silent
from solver_backend.fitters.measurements.markers import no_person_in
from solver_backend.labelling.outputs import GHOST, MARKERS
from solver_backend.types import Capture, MarkerCloud

if TYPE_CHECKING:
    from solver_backend.labelling.label_take import LabelledTake
    from solver_backend.labelling.point_network import LandmarkNetwork

UserLabels = Mapping[tuple[int, int], str]  # Marker name by (column, frame), assigned by the user.


LEAST_NAMED = 0.75
"""Share of points that the network must name before its labels replace unknown names. It names 83 and 100 % on whole
bodies (btkdata's mocap36, badParameterOffset), but at most 61 % on clusters or legs (c3d.org's sample 2)."""


LEAST_UNNAMED = 0.5
"""Share of nameless points that the network must name to find a person. It names 70 to 90 % on whole bodies with stray
points (c3d.org's samples 13 and 20), but 27 % on a body with 57 clustered markers."""


UNSURE_M = 0.13
"""Largest mean deviation of the network's positions for a person. The network states 8 to 94 mm in 12 takes of people
with half the points named, and 178 to 514 mm in 60 sets of 40 to 100 random points, still, swaying or walking."""


def needs_labels(cloud: MarkerCloud) -> bool:
    """Return whether too few labels are known for a solve, or at least half of the visible points are unnamed."""
    if cloud.labels is None:
        return True
    names = _names(cloud)
    if len(names.known) < least_markers(names.known.values()):
        return True
    if len(names.unknown) >= LEAST_MARKERS:
        return False  # the user named them with other words, and the solve finds their bones
    seen = np.isfinite(cloud.positions).all(-1).sum(0)
    nameless = [is_unnamed(label) for label in cloud.labels]
    return int(seen[nameless].sum()) >= int(seen[~np.array(nameless)].sum())


def _names(cloud: MarkerCloud) -> MarkerNames:
    return name_markers([label for label in cloud.labels or () if not is_unnamed(label)], places_by_side(cloud))


def has_own_names(cloud: MarkerCloud) -> bool:
    """Return whether most columns have a user-defined name, so that each column is one marker in all frames."""
    labels = cloud.labels or ()
    return sum(not is_unnamed(label) for label in labels) > len(labels) / 2


def named_points(cloud: MarkerCloud) -> dict[tuple[int, int], str]:
    """Return the names in a partly labelled take that the network must not change.

    A key is the column and the first frame of a continuous segment of a named marker. A value is the marker's location
    on the body.
    """
    if cloud.labels is None:
        return {}
    known = name_markers([label for label in cloud.labels if not is_unnamed(label)]).known
    seen = np.isfinite(cloud.positions).all(-1)
    begins = seen & ~np.roll(seen, 1, axis=0)
    begins[0] = seen[0]
    return {
        (column, int(frame)): known[label]
        for column, label in enumerate(cloud.labels)
        if known.get(label) in MARKERS
        for frame in np.flatnonzero(begins[:, column])
    }


def labelled_capture(
    capture: Capture,
    progress: Progress = silent,
    *,
    user_labels: UserLabels | None = None,
    network: LandmarkNetwork | None = None,
    always: bool = False,
) -> tuple[Capture, LabelledTake | None]:
    """Label a capture's points with the network, unless it has enough names.

    Args:
        user_labels: labels assigned by the user, by column and frame. Each label applies to the whole continuous
            segment of the point.
        network: the labelling network, by default the built-in one.
        always: also label a capture that has enough names. These names do not change (see ``named_points``).

    Raises:
        MarkersUnknown: the points have no names, and the network names too few of them.
    """
    cloud = capture.markers
    if cloud is None or capture.keypoints is not None or not (always or needs_labels(cloud)):
        return capture, None
    from solver_backend.fitters.recipes.live import fit_average_person
    from solver_backend.labelling.label_take import label_take
    from solver_backend.labelling.point_network import load_network

    if reason := no_person_in(cloud.positions):
        hint = "Record markers on the whole body, or label an arm or leg according to a layout. Faces cannot be solved."
        raise MarkersUnknown(f"{reason}. A person cannot be recognised.", where=capture.name, hint=hint)
    persistent = has_own_names(cloud)
    if not always and (unread := _crowd(capture, persistent=persistent)) is not None:
        return unread, None
    try:
        take = label_take(
            cloud,
            network or load_network(),
            fit_average_person,
            progress,
            {**named_points(cloud), **(user_labels or {})},
            persistent=persistent,
        )
    except (FileMissing, NoDetections):
        if always:
            raise
        return capture, None
    if persistent and not (always or knows_layout(take)):
        doubt = diagnostic("network_not_used", reason="layout", percent=100.0 * float(_named(take).mean()))
        return replace(capture, problems=(*capture.problems, doubt)), None
    if not (always or persistent) and (doubt := _doubt_of_person(take)):
        unlike = MarkersUnknown(
            f"The points have no labels, and the labelling network for whole bodies {doubt}.",
            where=capture.name,
            hint="Label the take in the program that recorded it, or with `markers label`. Correct the labels in "
            "Blender or with --labels, and solve the labelled file.",
        )
        return _by_own_names(capture, unlike), None
    return replace(
        capture,
        markers=take.cloud(cloud),
        notes=(*without_doubt_of_labels(capture.notes), named_in(take, persistent=persistent)),
        problems=(*without_doubt_of_labels(capture.problems), *unnamed_in(take)),
    ), take


def _doubt_of_person(take: LabelledTake) -> str:
    """Return a reason why the unnamed points are probably not one person, or "" if there is none."""
    share = float(_named(take).mean()) if take.labels.size else 1.0
    variance = np.trace(take.votes.covariance[:, :GHOST], axis1=-2, axis2=-1).mean() / 3.0
    if share < LEAST_UNNAMED:
        return f"recognises only {100 * share:.0f} % of them, too few for a person"
    if variance > UNSURE_M**2:
        return f"finds no person (its marker positions are uncertain by {1000 * variance**0.5:.0f} mm)"
    return ""


def _crowd(capture: Capture, *, persistent: bool) -> Capture | None:
    """Check whether a take has too many points for the labelling network.

    Return None if the network can label the points. Otherwise, return the capture to solve with the names that it
    already has.

    Raises:
        MarkersUnknown: there are too many points for the network, and too few names.
    """
    assert capture.markers is not None
    seen = np.isfinite(capture.markers.positions).all(-1).sum(axis=1)
    count = float(seen[seen > 0].mean()) if seen.any() else 0.0
    if count * (LEAST_NAMED if persistent else LEAST_UNNAMED) <= GHOST:
        return None
    if persistent:
        doubt = diagnostic("network_not_used", reason="people", count=count, most=GHOST)
        return replace(capture, problems=(*capture.problems, doubt))
    return _by_own_names(
        capture,
        MarkersUnknown(
            f"The points have no labels, and {count:.0f} of them are visible at once. The labelling network can "
            f"label one person with up to {GHOST} markers.",
            where=capture.name,
            hint="Label the points in the program that recorded them. If there are several people, give each of "
            "them a label prefix.",
        ),
    )


def _by_own_names(capture: Capture, otherwise: MarkersUnknown) -> Capture:
    """Return a partly labelled capture if it has enough names to be solved. Otherwise raise ``otherwise``."""
    cloud = capture.markers
    assert cloud is not None
    known = _names(cloud).known
    if len(known) < least_markers(known.values()):
        raise otherwise
    there = np.isfinite(cloud.positions).all(-1)
    nameless = there[:, [is_unnamed(label) for label in cloud.labels or ()]]
    left_out = diagnostic("points_not_named", extent="solve", percent=100.0 * float(nameless.sum() / there.sum()))
    return replace(capture, problems=(*capture.problems, left_out))


def without_doubt_of_labels(found: Sequence[Diagnostic]) -> tuple[Diagnostic, ...]:
    """Remove a reader's warnings about few known labels, because labelling solves this problem."""
    return tuple(item for item in found if item.code not in ("few_markers_known", "labels_left_to_network"))


def knows_layout(take: LabelledTake) -> bool:
    """Return whether the network recognises a take's marker layout: it names enough of the markers."""
    named = _named(take)
    return bool(named.size) and named.mean() >= LEAST_NAMED and len(_places(take)) >= LEAST_NETWORK_PLACES


def named_in(take: LabelledTake, *, persistent: bool = False) -> Diagnostic:
    """Return a note with the percentages of named, stray and unknown points.

    Args:
        persistent: the points had user-defined names.
    """
    labels = take.labels[np.isfinite(take.confidence)]
    named, nobody, unknown = (
        100.0 * float(np.mean(group)) if len(labels) else 0.0 for group in (_named(take), labels == GHOST, labels < 0)
    )
    return diagnostic(
        "points_named", basis="network", count=len(_places(take)), named=named, nobody=nobody, unknown=unknown
    )


def _named(take: LabelledTake) -> np.ndarray:
    labels = take.labels[np.isfinite(take.confidence)]
    return (labels >= 0) & (labels < GHOST)


def _places(take: LabelledTake) -> set[int]:
    return set(take.labels[np.isfinite(take.confidence)][_named(take)].tolist())


def unnamed_in(take: LabelledTake) -> tuple[Diagnostic, ...]:
    """Return a warning if many points remain without a name."""
    there = np.isfinite(take.confidence)
    unknown = float((take.labels[there] < 0).mean()) if there.any() else 1.0
    if unknown < 0.05:
        return ()
    return (diagnostic("points_not_named", extent="solve", percent=100.0 * unknown),)
