"""Every code, with severity, words, cause and advice; the reference page is made from this table."""

from __future__ import annotations

from .calibration import CALIBRATION
from .captures import CAPTURES
from .detections import DETECTIONS
from .entry import DiagnosticEntry, warning
from .extrinsics import EXTRINSICS
from .gloves import GLOVES
from .labels import LABELS
from .markers import MARKERS
from .motions import MOTIONS
from .ranges import RANGES
from .recording import RECORDING
from .result import RESULT
from .videos import VIDEOS
from .wand import WAND
from .world import WORLD

_SCENE: dict[str, DiagnosticEntry] = {
    "scene_message": warning("{text}", "Blender shows this part of a capture otherwise, or not at all.", ""),
}

GROUPS: dict[str, dict[str, DiagnosticEntry]] = {
    "Detections": DETECTIONS,
    "Recordings of views": CAPTURES,
    "Numbers of a capture": RANGES,
    "Calibrations": CALIBRATION,
    "Worlds": WORLD,
    "Calibrating and checking cameras": EXTRINSICS,
    "Marker files": MARKERS,
    "Labels of markers": LABELS,
    "Videos and sensors": VIDEOS,
    "Calibrating sensors by a wand": WAND,
    "Recordings": RECORDING,
    "Motions of other programs": MOTIONS,
    "Hands of gloves": GLOVES,
    "Results of a solve": RESULT,
    "Scenes": _SCENE,
}
"""By where they are found, in the order of the reference page."""

TABLE: dict[str, DiagnosticEntry] = {code: entry for group in GROUPS.values() for code, entry in group.items()}
"""All of them by code."""

READING = frozenset(TABLE) - RECORDING.keys() - RESULT.keys() - MOTIONS.keys() - GLOVES.keys()
"""Codes of what is found before a solve."""
