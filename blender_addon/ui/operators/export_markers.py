"""The operator that writes a take's markers for other programs, in the solver's process."""

from __future__ import annotations

from typing import TYPE_CHECKING

import bpy
from bpy_extras.io_utils import ExportHelper

from ..._exchange.errors import OutputNotWritable
from ..._exchange.marker_formats import FORMAT_NAMES, MARKER_FORMATS
from ...conventions.file_paths import absolute
from ..locations import RELATIVE
from .solver_operator import SolverOperator

if TYPE_CHECKING:
    from ..._exchange.verb_results import MarkersResult

_FORMATS = tuple((ending, *texts) for ending, texts in MARKER_FORMATS.items())
_ENDINGS = ", ".join(f".{ending}" for ending in MARKER_FORMATS)
_CONTENTS = (
    ("cleaned", "Cleaned", "As recorded, with gaps filled and exchanged labels corrected"),
    ("solved", "Solved", "Where the solved body has them"),
)


class MOCAP_OT_export_markers(SolverOperator, bpy.types.Operator, ExportHelper):
    """Writes the markers of the take that the body plays."""

    bl_idname = "mocap.export_markers"
    bl_label = "Export Markers"
    bl_description = f"Write the markers of the take that the body plays as {FORMAT_NAMES}"
    bl_options = {"PRESET"}  # noqa: RUF012 - Blender reads a plain set

    filepath: bpy.props.StringProperty(subtype="FILE_PATH", options={"HIDDEN", "SKIP_SAVE"} | RELATIVE)
    format: bpy.props.EnumProperty(name="Format", items=_FORMATS, default="c3d")
    contents: bpy.props.EnumProperty(name="Markers", items=_CONTENTS, default="cleaned")
    overwrite: bpy.props.BoolProperty(
        name="Overwrite", description="Replace a file that is there", default=False, options={"HIDDEN", "SKIP_SAVE"}
    )
    filter_glob: bpy.props.StringProperty(
        default=";".join(f"*.{ending}" for ending in MARKER_FORMATS), options={"HIDDEN"}
    )

    @property
    def filename_ext(self) -> str:
        """Return the suffix the file browser gives the name."""
        return f".{self.format}"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Needs a take of markers."""
        if context.scene.mocap.review.take is None or not context.scene.mocap.capture.marker_items:
            cls.poll_message_set("Solve a recording of markers first")
            return False
        return super().poll(context)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Open the file browser, which asks before a file is replaced."""
        self.overwrite = True
        if not self.filepath:
            self.filepath = f"{bpy.path.clean_name(context.scene.mocap.review.take.name)}{self.filename_ext}"
        return ExportHelper.invoke(self, context, event)

    def work(self, context: bpy.types.Context) -> set[str]:
        """Start writing."""
        from ...animation.takes import take_file
        from ..locations import usable

        if self.filepath.startswith("//") and not bpy.data.filepath:
            message = "A path that starts with // needs a saved file."
            raise OutputNotWritable(message, where=self.filepath, hint="Save it, or name the whole path.")
        path = absolute(self.filepath)
        options = ["--out", str(path), "--contents", self.contents, *(["--overwrite"] if self.overwrite else [])]
        motion = take_file(context.scene.mocap.review.take, "motion_file")
        return self.launch(context, "export-markers", [str(motion), *options], usable(path.parent))

    def received(self, context: bpy.types.Context, result: MarkersResult) -> set[str]:
        """Report what was written."""
        name = absolute(self.filepath).name
        count = f"{result['frames']} frames of {result['markers']} {self.contents} markers"
        self.report({"INFO"}, f"Wrote {count} to {name}")
        return {"FINISHED"}


def draw_export_menu(self: bpy.types.Menu, context: bpy.types.Context) -> None:
    """Draw the entry in File > Export."""
    self.layout.operator(MOCAP_OT_export_markers.bl_idname, text=f"Motion Capture Markers ({_ENDINGS})")
