"""On top of all panels: the Solve button or, while something runs, its progress and Cancel."""

from __future__ import annotations

import bpy

from ..operators.solver_operator import MOCAP_OT_cancel, current
from .frame_rate import draw_rate, is_laid_otherwise
from .parts import MocapPanel, draw_solve, fits, wrapped


class VIEW3D_PT_mocap_run(MocapPanel, bpy.types.Panel):
    """What is solved with one click, or is under way."""

    bl_idname = "VIEW3D_PT_mocap_run"
    bl_label = "Solve or Cancel"
    bl_options = {"HIDE_HEADER"}  # noqa: RUF012 - Blender reads a plain set
    bl_order = -1

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Needs a run, a capture that can be solved, or something that plays at a wrong speed."""
        return current.busy or bool(context.scene.mocap.capture.file) or is_laid_otherwise(context.scene)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the button, or how far the run is and the button that ends it."""
        run = current.run
        if run is None:
            draw_rate(self.layout, context)
            if context.scene.mocap.capture.file:
                draw_solve(self.layout, context)
            return
        column = self.layout.column(align=True)
        on_the_bar = fits(context, run.headline)
        column.progress(factor=run.share, text=run.headline if on_the_bar else f"{run.share:.0%}", translate=False)
        if not on_the_bar:
            wrapped(column, context, run.headline)
        row = column.row(align=True)
        row.enabled = not run.process.cancelling
        row.operator(MOCAP_OT_cancel.bl_idname, icon="CANCEL")
