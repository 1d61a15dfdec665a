"""Label a take by comparing it with another take of the same person and layout."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from solver_backend.body.files.choices import load_chosen_body
from solver_backend.body.marker_names import LEAST_MARKERS, is_unnamed, name_markers
from solver_backend.exchange.diagnostics import diagnostic
from solver_backend.exchange.errors import FileMissing, MarkersUnknown, NoDetections
from solver_backend.exchange.progress import Progress, silent
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters.label_first import has_own_names, without_doubt_of_labels
from solver_backend.fitters.marker_calibration.extra_names import named_extras, with_extras
from solver_backend.fitters.recipes.live import fit_average_person
from solver_backend.labelling.label_like import LikeTake, label_like, reference_of
from solver_backend.labelling.label_take import label_take
from solver_backend.labelling.outputs import GHOST, MARKERS
from solver_backend.labelling.point_network import PointNetwork, load_network
from solver_backend.types import Capture, MarkerCloud, MarkerSubject

UNSURE_SHARE = 0.05  # Share of unnamed points above which the take needs a review.
LEAST_SEEN = 10  # Smallest number of frames in which the labelled take shows a marker.


def labelled_like(
    capture: Capture, like: Capture, progress: Progress = silent, network: PointNetwork | None = None
) -> tuple[Capture, LikeTake]:
    """Label a capture's points with the marker names of another take.

    Raises:
        NoDetections: a take has no markers, or no frame has enough markers.
        MarkersUnknown: the other take has too few labelled markers.
    """
    if capture.markers is None or like.markers is None:
        raise NoDetections("Both takes must be marker recordings.", hint="Choose C3D, TRC or CSV files.")
    cloud, reference = capture.markers, worn(like.markers)
    if len(reference.labels or ()) < LEAST_MARKERS:
        raise MarkersUnknown(
            f"The labelled take has {len(reference.labels or ())} labelled markers, but {LEAST_MARKERS} are needed.",
            where=like.name,
            hint="Choose a take with labelled markers.",
        )
    persistent = has_own_names(cloud)
    proposed = _proposed(cloud, reference, progress, network, persistent=persistent)
    take = label_like(cloud, reference_of(reference), persistent=persistent, proposed=proposed)
    there = np.isfinite(cloud.positions).all(-1)
    found = take.point_labels[there]
    unknown, places = float((found < 0).mean()), len(set(found[found >= 0].tolist()))
    note = diagnostic("points_named", basis="take", take=like.name, named=100.0 * (1.0 - unknown), count=places)
    unsure = unknown > UNSURE_SHARE
    doubts = [diagnostic("points_not_named", extent="take", percent=100.0 * unknown)] if unsure else []
    kept = without_doubt_of_labels(capture.problems)
    return replace(
        capture,
        markers=take.cloud(cloud),
        notes=(*without_doubt_of_labels(capture.notes), note),
        problems=(*kept, *doubts),
    ), take


def worn(cloud: MarkerCloud) -> MarkerCloud:
    """Select the named markers of a labelled take. Rare and computed markers are excluded."""
    labels = cloud.labels or ()
    virtual = set(name_markers([label for label in labels if not is_unnamed(label)]).virtual)
    seen = np.isfinite(cloud.positions).all(-1).sum(0)
    least = min(LEAST_SEEN, len(cloud.positions))
    kept = [i for i, label in enumerate(labels) if not is_unnamed(label) and label not in virtual and seen[i] >= least]
    return cloud.columns(kept)


def _proposed(
    cloud: MarkerCloud, reference: MarkerCloud, progress: Progress, network: PointNetwork | None, *, persistent: bool
) -> np.ndarray | None:
    """Label points (F, N) with the network. Return each point's column in the reference take, -1 if unknown.

    Return None if the network cannot label the points, or knows too few markers of the reference.
    """
    try:
        network = network or load_network()
        column = _columns(reference, network)
        if (column >= 0).sum() < LEAST_MARKERS:
            return None
        take = label_take(replace(cloud, labels=None), network, fit_average_person, progress, persistent=persistent)
    except (FileMissing, NoDetections):
        return None
    return np.where(take.labels >= 0, column[take.labels], -1)


def _columns(reference: MarkerCloud, network: PointNetwork) -> np.ndarray:
    """Return each network marker's column in the reference take, or -1 if the take lacks this marker.

    If the take's labels identify too few markers, its points are labelled by the network.
    """
    labels = reference.labels or ()
    known = name_markers(labels).known
    column = np.full(GHOST + 1, -1)
    for i, label in enumerate(labels):
        if known.get(label) in MARKERS:
            column[MARKERS.index(known[label])] = i
    if (column >= 0).sum() >= LEAST_MARKERS:
        return column
    take = label_take(replace(reference, labels=None), network, fit_average_person, persistent=True)
    for place, stretch in zip(*np.unique(take.tracklets.column, return_index=True), strict=True):
        if 0 <= take.stretch_label[stretch] < GHOST:
            column[take.stretch_label[stretch]] = place
    return column


def labelled_as_person(
    capture: Capture,
    person: MarkerSubject,
    settings: SolveSettings = SolveSettings(),
    progress: Progress = silent,
    *,
    kept: Collection[str] = (),
) -> Capture:
    """Label a capture with the marker names of a calibrated person. Names in ``kept`` do not change.

    Raises:
        SubjectInvalid: the person was calibrated on another body or wears other markers.
    """
    if capture.markers is None:
        return capture
    body = load_chosen_body(settings.body)
    named = named_extras(capture.markers, person, body, progress, kept)
    notes = [diagnostic("points_named_of_person", count=len(named.named), markers=named.named)] if named.named else []
    doubts = [diagnostic("points_not_named", extent="tracks", count=named.doubtful)] if named.doubtful else []
    problems = [item for item in capture.problems if item.code != "points_not_named" or not named.named]
    if len(problems) < len(capture.problems):
        seen = np.isfinite(named.cloud.positions).all(-1).sum(0)
        nameless = float(seen[[is_unnamed(label) for label in named.cloud.labels or ()]].sum() / seen.sum())
        if nameless >= UNSURE_SHARE:
            doubts.append(diagnostic("points_not_named", extent="solve", percent=100.0 * nameless))
    return replace(capture, markers=named.cloud, notes=(*capture.notes, *notes), problems=(*problems, *doubts))


def person_of_nameless(
    person: MarkerSubject,
    captures: Sequence[Capture],
    settings: SolveSettings = SolveSettings(),
    progress: Progress = silent,
) -> MarkerSubject:
    """In labelled takes, find unlabelled markers that move with a bone, and add them to a person's record."""
    clouds = [capture.markers for capture in captures if capture.markers is not None]
    if not clouds:
        return person
    return with_extras(person, clouds, load_chosen_body(settings.body), progress)
