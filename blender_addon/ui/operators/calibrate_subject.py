"""Calibrating who wears the markers, for all takes of that person."""

from __future__ import annotations

from typing import TYPE_CHECKING

import bpy

from ...conventions.file_paths import stored
from ..project_files import bring_home
from .solver_operator import SolverOperator

if TYPE_CHECKING:
    from ..._exchange.verb_results import PersonResult


class MOCAP_OT_calibrate_subject(SolverOperator, bpy.types.Operator):
    """Learns a person's shape and where every marker sits, which solves then start from."""

    bl_idname = "mocap.calibrate_subject"
    bl_label = "Calibrate Subject"
    bl_description = (
        "Learn the person's shape and marker places from this recording, best one with much movement. It and the "
        "person's other recordings are then solved with them"
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Needs a recording of markers."""
        if not context.scene.mocap.capture.marker_items:
            cls.poll_message_set("Import a recording of markers first")
            return False
        return super().poll(context)

    def work(self, context: bpy.types.Context) -> set[str]:
        """Start."""
        from ...solving.take_paths import next_subject
        from ..scene_job import capture_file, folder_of_takes, write_layout

        settings = context.scene.mocap
        capture = capture_file(settings.capture)
        out = next_subject(folder_of_takes(context.scene, capture.parent))
        layout = write_layout(settings.capture, out.with_suffix(".layout.json"))
        by_hand = [] if layout is None else ["--layout", str(layout)]
        options = ["--out", str(out), *(["--body", settings.solve.body] if settings.solve.body else [])]
        return self.launch(context, "calibrate", [str(capture), *options, *by_hand], out.parent)

    def received(self, context: bpy.types.Context, result: PersonResult) -> set[str]:
        """Solve with this person from now on."""
        context.scene.mocap.solve.subject = stored(result["subject"])
        bring_home()
        self.report({"INFO"}, f"Calibrated: {calibrated(result)}")
        return {"FINISHED"}


def calibrated(result: PersonResult) -> str:
    """Return what a calibration found, in a line.

    Args:
        result: result event of the verb ``calibrate``.
    """
    markers = result["markers"]
    label, far = max(markers.items(), key=lambda item: item[1]["offset_mm"])
    name = label.rpartition(":")[2]
    return f"{len(markers)} markers; {name} is farthest from the place of its name, {far['offset_mm']:.0f} mm"
