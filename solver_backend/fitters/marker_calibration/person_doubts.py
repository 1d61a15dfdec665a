"""What a calibration found doubtful of a person's markers, from the person's record."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from solver_backend.body.markers import ON_BONE
from solver_backend.exchange.diagnostics import Diagnostic, Remedy, diagnostic
from solver_backend.labelling.names_over_takes import NameChange
from solver_backend.types import MarkerSubject

MISPLACED = "misplaced"
"""What a person's provenance calls labels whose names are not used, each with the place that it names and its distance
in metres."""
TWO_PLACES = "two_places"
"""What it calls labels that are left out since two takes show them at different places, each with the distance in
metres and the takes' numbers, from 1."""

EXCHANGED = "exchanged"
"""What it calls pairs of labels that name each other's markers in all takes."""
NAMES_OVER_TAKES = "names_over_takes"
"""What it calls names that stand for each other's markers in one take: the take's number from 1, both labels (the
second empty where no other point fits), and whether they were exchanged."""
SIDE_FOUND = "side_found"
"""What it calls labels that name a limb without its side, each with the place that was found."""


def doubts_of(person: MarkerSubject) -> list[Diagnostic]:
    """Return which names of markers were not used, which markers were left out, and which sides were found."""
    return [*_side_found(person), *_over_takes(person), *_misplaced(person), *_two_places(person)]


def over_takes(changes: Sequence[NameChange]) -> dict[str, Any]:
    """Return what a person's provenance records of names that single takes have the other way round."""
    rows = [[change.take + 1, change.first, change.second, change.mended] for change in changes]
    return {NAMES_OVER_TAKES: rows} if rows else {}


def exchanged_in(person: MarkerSubject) -> list[Diagnostic]:
    """Return which labels name each other's markers, which a solve of the take itself reports with its frames."""
    pairs = person.provenance.get(EXCHANGED, ())
    return [diagnostic("markers_exchanged", markers=sorted(pair), remedy=Remedy.REPAIRED) for pair in pairs]


def _side_found(person: MarkerSubject) -> list[Diagnostic]:
    """Return on which side a limb is whose labels name none."""
    found = person.provenance.get(SIDE_FOUND, ())
    labels = [label for label, _ in found]
    side = "right" if found and found[0][1].startswith("R") else "left"
    return [diagnostic("limb_side_found", markers=labels, side=side)] if found else []


def _misplaced(person: MarkerSubject) -> list[Diagnostic]:
    """Return that names of markers were not used."""
    found = person.provenance.get(MISPLACED, ())
    if not found:
        return []
    named = sum(not place.startswith(ON_BONE) for place in person.places) + len(found)
    if 2 * len(found) >= named:
        labels = [label for label, *_ in found]
        return [diagnostic("markers_of_nobody", markers=labels, count=len(found), named=named)]
    texts = [f"{label} as {place} ({1000 * off:.0f} mm)" for label, place, off in found]
    return [diagnostic("markers_off_place", markers=[label for label, *_ in found], places=", ".join(texts))]


def _two_places(person: MarkerSubject) -> list[Diagnostic]:
    """Return that markers were left out since they are elsewhere in another take."""
    found = person.provenance.get(TWO_PLACES, ())
    texts = [f"{label} by {1000 * apart:.0f} mm between takes {a} and {b}" for label, apart, a, b in found]
    labels = [label for label, *_ in found]
    return [diagnostic("marker_in_two_places", markers=labels, places=", ".join(texts))] if found else []


def _over_takes(person: MarkerSubject) -> list[Diagnostic]:
    """Return which names were exchanged in single takes, and which takes differ without a decision."""
    found = person.provenance.get(NAMES_OVER_TAKES, ())
    diagnostics: list[Diagnostic] = []
    for code, wanted in (("names_exchanged_in_takes", True), ("names_differ_between_takes", False)):
        items = [(take, [label for label in (a, b) if label]) for take, a, b, mended in found if mended is wanted]
        texts = [f"{' and '.join(labels)} in take {take}" for take, labels in items]
        labels = [label for _, several in items for label in several]
        diagnostics += [diagnostic(code, markers=labels, places=", ".join(texts))] if items else []
    return diagnostics
