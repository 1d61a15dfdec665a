"""A file of optical markers as a capture of one person."""

from __future__ import annotations

from pathlib import Path

from solver_backend.body.hand_markers import hand_labels
from solver_backend.body.joint_names import is_joint_centre
from solver_backend.body.marker_names import (
    LEAST_MARKERS,
    LEAST_NETWORK_PLACES,
    MarkerNames,
    is_unnamed,
    least_markers,
    name_markers,
)
from solver_backend.body.side_by_place import places_by_side
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.errors import JobInvalid
from solver_backend.io.markers.read import MARKERS
from solver_backend.io.markers.subjects import of_subject
from solver_backend.io.markers.take import MarkerTake
from solver_backend.io.reader import Reader, ReadOptions
from solver_backend.types import Capture


def _as_captures(reader: Reader[MarkerTake]) -> Reader[Capture]:
    def read(path: Path, options: ReadOptions) -> Capture:
        return _capture(path, reader.read(path, options), options)

    return Reader(reader.kind, reader.recognises, read)


def _capture(path: Path, take: MarkerTake, options: ReadOptions) -> Capture:
    """Return the markers of one subject, all of them, with what was recognised.

    Raises:
        JobInvalid: the file holds several subjects and none is named, or the named one is not among them.
    """
    try:
        take = of_subject(take, options.subject_prefix)
    except JobInvalid as error:
        raise JobInvalid(error.message, where=str(path), hint=error.hint) from error
    labels, report = take.cloud.labels, take.report
    hands = hand_labels(labels or ())
    of_body = [label for label in labels or () if label not in hands and not is_unnamed(label)]
    names = None if labels is None else name_markers(of_body, places_by_side(take.cloud))
    left = sum(place.startswith("L") for place in hands.values())
    found = [diagnostic("labels_of_hands", left=left, right=len(hands) - left)] if hands else []
    return Capture(
        name=path.stem,
        markers=take.cloud,
        others=take.others,
        sources=(str(path),),
        notes=(*report.notes, *found, *_labels(names, report.unlabelled)),
        problems=(*report.problems, *([] if names is None else _few(names))),
    )


def _labels(names: MarkerNames | None, nameless: tuple[str, ...]) -> list[Diagnostic]:
    """Return notes on how labels are read, and on the markers that the solve leaves out."""
    if names is None:
        return []
    if left_to_network(names):
        count, total = len(names.known), len(names.known) + len(names.unknown)
        return [diagnostic("labels_left_to_network", count=count, total=total)]
    shared = (("label_prefix_shared", names.affixes.prefix), ("label_suffix_shared", names.affixes.suffix))
    notes = [diagnostic(code, text=text) for code, text in shared if text]
    if names.ambiguous:
        choices = [f"{label} ({' or '.join(places)})" for label, places in names.ambiguous.items()]
        notes.append(diagnostic("labels_ambiguous", markers=tuple(names.ambiguous), choices=choices))
    joints = any(is_joint_centre(place) for place in names.known.values())
    if joints:
        notes.append(diagnostic("labels_of_joint_centres", count=len(names.known)))
    groups = (
        ("labels_of_no_layout", names.unknown),
        ("differing_joints_left_out" if joints else "computed_points_left_out", names.virtual),
        ("doubled_points_left_out", names.doubled),
        ("nameless_points_left_out", nameless),
    )
    return notes + [diagnostic(code, markers=labels, count=len(labels)) for code, labels in groups if labels]


def left_to_network(names: MarkerNames) -> bool:
    """Return whether labels name too few places for a solve, and there are markers enough to be named otherwise."""
    return len(names.known) < LEAST_MARKERS and len(names.known) + len(names.unknown) >= LEAST_NETWORK_PLACES


def _few(names: MarkerNames) -> list[Diagnostic]:
    """Return a diagnostic if the known markers are too few for a solve."""
    known, least = list(names.known), least_markers(names.known.values())
    if len(known) >= least or left_to_network(names):
        return []
    return [diagnostic("few_markers_known", markers=known, count=len(known), least=least)]


READERS = tuple(_as_captures(reader) for reader in MARKERS)
"""One of captures for every kind of marker file."""
