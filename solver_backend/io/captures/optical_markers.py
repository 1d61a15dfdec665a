"""A file of optical markers as a capture of one person."""

from __future__ import annotations

from pathlib import Path

from solver_backend.body.joint_names import is_joint_centre
from solver_backend.body.marker_names import LEAST_MARKERS, MarkerNames, is_unnamed, name_markers
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.errors import JobInvalid
from solver_backend.io.markers.read import MARKERS
from solver_backend.io.markers.subjects import of_subject
from solver_backend.io.markers.take import MarkerTake
from solver_backend.io.reader import Reader, ReadOptions
from solver_backend.io.recognition.camera_names import listing
from solver_backend.types import Capture


def marker_readers() -> tuple[Reader[Capture], ...]:
    """Return a reader of captures for every kind of marker file."""
    return tuple(_as_captures(reader) for reader in MARKERS)


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
    names = None if labels is None else name_markers([label for label in labels if not is_unnamed(label)])
    return Capture(
        name=path.stem,
        markers=take.cloud,
        others=take.others,
        sources=(str(path),),
        notes=(*report.notes, *_said(names, report.unlabelled)),
        problems=(*report.problems, *([] if names is None else _few(names))),
    )


def _said(names: MarkerNames | None, unlabelled: tuple[str, ...]) -> list[str]:
    """Return sentences on the markers that the solve leaves out."""
    if names is None:
        return []
    attached = names.unknown
    shared = ((names.affixes.prefix, "begins"), (names.affixes.suffix, "ends"))
    messages = [
        f"'{text}' {does} nearly all labels and is read as no part of their names." for text, does in shared if text
    ]
    if names.ambiguous:
        either = [f"{label} ({' or '.join(places)})" for label, places in names.ambiguous.items()]
        messages.append(
            f"Labels that may name either of two places, which are not guessed: {_first(tuple(either), 4)}."
        )
    joints = any(is_joint_centre(place) for place in names.known.values())
    if joints:
        messages.append(f"The labels are joint centres of a skeleton: {len(names.known)} of them are solved as such.")
    messages += [] if not attached else [
        f"Labels of no layout ({len(attached)}): {_first(attached)}. The solve finds the bone that each moves with, or "
        "leaves it out."
    ]  # fmt: skip
    groups = (
        (names.virtual, "joints whose place differs between skeletons" if joints else "points that a program computed"),
        (names.doubled, "points of places that another marker has"),
        (unlabelled, "points without names"),
    )
    return messages + [
        f"Left out of the solve: {what} ({len(labels)}), {_first(labels)}." for labels, what in groups if labels
    ]


def _few(names: MarkerNames) -> list[Diagnostic]:
    """Return a diagnostic if the known markers are too few for a solve."""
    if len(names.known) >= LEAST_MARKERS:
        return []
    known = list(names.known)
    return [diagnostic("few_markers_known", markers=known, count=len(known), least=LEAST_MARKERS)]


def _first(labels: tuple[str, ...], most: int = 12) -> str:
    return listing(labels[:most]) + (f" and {len(labels) - most} others" if len(labels) > most else "")
