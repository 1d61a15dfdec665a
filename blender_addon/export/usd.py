"""USD by Blender's exporter: metres and Z up, said in the file; a skeleton of the deforming bones, every frame."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..progress import Progress
from .blender_exporters import run_exporter
from .plain_take import plain_take
from .take import ExportTake, chosen


def export_usd(path: Path, take: ExportTake, progress: Progress) -> None:
    """Write the armature, its meshes and the motion."""
    progress("exporting USD", 0, 1)
    with plain_take(take, progress) as plain, chosen(plain):
        run_exporter(
            bpy.ops.wm.usd_export,
            path,
            {
                "selected_objects_only": True,
                "export_animation": True,
                "export_materials": True,
            },
            {
                "export_armatures": True,
                "only_deform_bones": True,
                "export_shapekeys": True,
                "convert_orientation": False,
                "root_prim_path": "/root",
                "allow_unicode": True,
                "convert_world_material": False,
            },
        )
    progress("exporting USD", 1, 1)
