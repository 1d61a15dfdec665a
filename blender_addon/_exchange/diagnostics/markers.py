"""Diagnostics of readers of markers and of labelling: what was found in a file, and what it was taken for."""

from __future__ import annotations

from .entry import DiagnosticEntry, warning

MARKERS: dict[str, DiagnosticEntry] = {
    "few_markers_known": warning(
        "Only {count} markers are known, {markers}; a solve needs {least}",
        "Labels name no places on a body, or the file holds a part of the recording.",
        "Name the points with `label`, or write the labels' places with `layout` and solve with `--layout`.",
    ),
}
