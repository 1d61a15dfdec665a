"""Read an optical marker file as a capture of one person."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from solver_backend.body.hand_markers import hand_labels
from solver_backend.body.joint_names import is_joint_centre
from solver_backend.body.marker_layouts import load_layouts
from solver_backend.body.marker_names import (
    LEAST_MARKERS,
    LEAST_NETWORK_PLACES,
    MarkerNames,
    is_unnamed,
    least_markers,
    name_markers,
    named_bone,
    places_by_side,
)
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.errors import JobInvalid
from solver_backend.io.camera_names import listing
from solver_backend.io.markers.read import MARKERS
from solver_backend.io.markers.source import MarkerTake
from solver_backend.io.reader import Reader, ReadOptions
from solver_backend.io.recognition.marker_labels import prefix_of
from solver_backend.types import Capture, MarkerCloud

SEPARATOR = ","  # Separator between several prefixes that belong to one person.


def of_subject(take: MarkerTake, given: str | None = None) -> MarkerTake:
    """Select the markers of one person.

    Args:
        take: markers of one or more subjects.
        given: prefix of the subject without its colon, or several comma-separated prefixes that belong to one person.
            None chooses the only subject, or the only one with body markers.

    Raises:
        JobInvalid: the subject is ambiguous, or the file does not contain the given subject.
    """
    subjects = take.subjects
    if given is None:
        if len(subjects) < 2:
            return take
        places = {name: _places(take, name) for name in subjects}
        bodies = [name for name in subjects if len(places[name]) >= LEAST_MARKERS] or _parts(subjects, places)
        if len(bodies) != 1:
            what = f"The file contains {len(subjects)} subjects: {_counts(take)}."
            raise JobInvalid(what, where="subject_prefix", hint=_hint(bodies, places))
        # Rigid bodies that are named after a bone and have no landmarks also belong to that person.
        names = (bodies[0], *(name for name in subjects if not places[name] and named_bone(f"{name}:1")))
        chosen = _part(take, names, [name for name in subjects if not places[name] and name not in names])
        others = [f"{name} ({_size(take, name)} markers)" for name in subjects if name not in names]
        note = diagnostic("subject_chosen", person=listing(names), others=others)
        return replace(chosen, notes=(*chosen.notes, note))
    names = (given,) if given in subjects else tuple(name.strip() for name in given.split(SEPARATOR))
    for name in names:
        if name not in subjects:
            what = f"The file has no subject '{name}'. It contains {_counts(take) or 'labels without prefixes'}."
            raise JobInvalid(what, where="subject_prefix", hint="Choose one of these subjects by its prefix.")
    beside = [name for name in subjects if name not in names]
    bodies = _parts(tuple(beside), {name: _places(take, name) for name in beside})
    return _part(take, names, [name for name in beside if name not in bodies])


def _part(take: MarkerTake, names: tuple[str, ...], things: Sequence[str]) -> MarkerTake:
    labels = take.cloud.labels or ()
    kept = [i for i, label in enumerate(labels) if prefix_of(label) in names]
    unlabelled = tuple(label for label in take.unlabelled if prefix_of(label) in names)
    beside = [i for i, label in enumerate(labels) if prefix_of(label) in things]
    others = joined_columns(take.others, take.cloud.columns(beside, tuple(labels[i] for i in beside)))
    cloud = take.cloud.columns(kept, tuple(labels[i] for i in kept))
    return replace(take, cloud=cloud, subjects=names, unlabelled=unlabelled, others=others)


def joined_columns(one: MarkerCloud | None, two: MarkerCloud) -> MarkerCloud | None:
    """Join the markers of two clouds that have the same frames. The first cloud may be None."""
    if not two.labels:
        return one
    if one is None:
        return replace(two, residual=None, covariance=None)
    positions = np.concatenate([one.positions, two.positions], axis=1)
    return MarkerCloud(positions, two.fps, (*(one.labels or ()), *two.labels))


def _places(take: MarkerTake, name: str) -> frozenset[str]:
    labels = [label for label in take.cloud.labels or () if prefix_of(label) == name]
    return frozenset(name_markers(labels).known.values())


def _size(take: MarkerTake, name: str) -> int:
    return sum(prefix_of(label) == name for label in take.cloud.labels or ())


def _counts(take: MarkerTake) -> str:
    return listing(f"{name} ({_size(take, name)} markers)" for name in take.subjects)


def _parts(subjects: tuple[str, ...], places: dict[str, frozenset[str]]) -> list[str]:
    words = load_layouts().words
    return [name for name in subjects if places[name] or words.of(name)[1] or words.of_glued(name)[1]]


def _hint(parts: list[str], places: dict[str, frozenset[str]]) -> str:
    one = "Choose one with --subject-prefix NAME (in Blender, Subject under Reading Options)."
    claimed = [place for name in parts for place in places[name]]
    if len(parts) < 2 or len(claimed) > len(set(claimed)):
        return one
    return f"{one} If they are parts of one person, name all of them with --subject-prefix {SEPARATOR.join(parts)}."


def _capture(path: Path, take: MarkerTake, options: ReadOptions) -> Capture:
    try:
        take = of_subject(take, options.subject_prefix)
    except JobInvalid as error:
        raise JobInvalid(error.message, where=str(path), hint=error.hint) from error
    labels, notes, problems = take.cloud.labels, list(take.notes), take.problems
    hands = hand_labels(labels or ())
    if hands:
        left = sum(place.startswith("L") for place in hands.values())
        notes.append(diagnostic("labels_of_hands", left=left, right=len(hands) - left))
    if labels is not None:
        of_body = [label for label in labels if label not in hands and not is_unnamed(label)]
        names = name_markers(of_body, places_by_side(take.cloud))
        notes += _label_notes(names, take.unlabelled)
        known, least = list(names.known), least_markers(names.known.values())
        if len(known) < least and not left_to_network(names):
            few = diagnostic("few_markers_known", markers=known, count=len(known), least=least)
            problems = (*problems, few)
    sources, found = (str(path),), tuple(notes)
    return Capture(path.stem, markers=take.cloud, others=take.others, sources=sources, notes=found, problems=problems)


def _label_notes(names: MarkerNames, nameless: tuple[str, ...]) -> list[Diagnostic]:
    if left_to_network(names):
        count, total = len(names.known), len(names.known) + len(names.unknown)
        return [diagnostic("labels_left_to_network", count=count, total=total)]
    shared = (names.affixes.prefix, names.affixes.suffix)
    notes = [diagnostic("label_affix_shared", text=text) for text in shared if text]
    if names.ambiguous:
        choices = [f"{label} ({' or '.join(places)})" for label, places in names.ambiguous.items()]
        notes.append(diagnostic("labels_ambiguous", markers=tuple(names.ambiguous), choices=choices))
    joints = any(is_joint_centre(place) for place in names.known.values())
    if joints:
        notes.append(diagnostic("labels_of_joint_centres", count=len(names.known)))
    if names.unknown:
        notes.append(diagnostic("labels_of_no_layout", markers=names.unknown, count=len(names.unknown)))
    groups = {"joints" if joints else "computed": names.virtual, "doubled": names.doubled, "nameless": nameless}
    return notes + [
        diagnostic("points_left_out", reason=reason, markers=labels, count=len(labels))
        for reason, labels in groups.items()
        if labels
    ]


def left_to_network(names: MarkerNames) -> bool:
    """Return whether too few labels are known for a solve, but there are enough markers for the labelling network."""
    return len(names.known) < LEAST_MARKERS and len(names.known) + len(names.unknown) >= LEAST_NETWORK_PLACES


def _as_captures(reader: Reader[MarkerTake]) -> Reader[Capture]:
    def read(path: Path, options: ReadOptions) -> Capture:
        return _capture(path, reader.read(path, options), options)

    return Reader(reader.kind, reader.recognises, read, reader.takes | {"subject_prefix"})


READERS = tuple(map(_as_captures, MARKERS))  # Capture readers, one per type of marker file.
