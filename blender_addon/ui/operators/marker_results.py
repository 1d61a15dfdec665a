"""What the solver reported about a capture's markers is put into the scene's settings."""

from __future__ import annotations

from typing import TYPE_CHECKING

import bpy

from ...scene.capture_stage import CaptureStage
from ...scene.marker_cloud import LABELS, labels_of

if TYPE_CHECKING:
    from ..._exchange.verb_results import CaptureSummary

_NAMED = ("known", "unknown", "computed", "doubled")


def take_markers(capture: bpy.types.PropertyGroup, result: CaptureSummary, stage: CaptureStage) -> None:
    """Keep what each label means and which gaps it has, and which object shows the markers.

    Args:
        capture: settings of the scene's capture.
        result: result event of the verb ``convert``.
        stage: the capture's objects.
    """
    names = result.get("marker_names") or {}
    capture.markers = result["markers"] or 0
    capture.subjects = ", ".join(names.get("subjects", ()))
    capture.cloud = next((overlay for overlay in stage.overlays if LABELS in overlay), None)
    bones = {item.name: item.bone for item in capture.marker_items}
    capture.marker_items.clear()
    if capture.cloud is None:
        return
    meaning = {label: kind for kind in _NAMED for label in names.get(kind, ())}
    gaps = {gap["marker"]: gap for gap in names.get("gaps", ())}
    labels = labels_of(capture.cloud)
    for index in reversed(range(len(capture.told))):
        item = capture.told[index]
        if not (item.point < len(labels) and labels[item.point] == item.name):  # it was read anew as another recording
            capture.told.remove(index)
    for label in labels:
        item, gap = capture.marker_items.add(), gaps.get(label, {})
        item.name, item.meaning = label, meaning.get(label, "unlabelled")
        item.bone = bones.get(label, "AUTO")
        item.gaps, item.missing_percent = gap.get("gaps", 0), gap.get("missing_percent", 0.0)
