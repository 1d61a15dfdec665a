"""USD by Blender's exporter: metres and Z up, stated in the file; a skeleton of the deforming bones, every frame."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..._exchange.progress import Progress
from ..plain_take import plain_take
from ..take import ExportTake, chosen
from .blender_exporters import require_space, require_whole, run_exporter

_BYTES_PER_VERTEX, _BYTES_PER_FRAME = 250, 2000
_UNWRITABLE = "betas"
"""Custom property of a body that USD has no type for: Blender warns of it on the console, in every frame."""


def export_usd(path: Path, take: ExportTake, progress: Progress) -> None:
    """Write the armature, its meshes and the motion.

    Raises:
        OSError: the disk is too full for it.
    """
    progress("exporting USD", 0, 1)
    vertices = sum(len(mesh.data.vertices) for mesh in take.meshes)
    require_space(path, _BYTES_PER_VERTEX * vertices + _BYTES_PER_FRAME * take.num_frames)
    with plain_take(take, progress) as plain, chosen(plain):
        if plain.is_plain:
            plain.armature.pop(_UNWRITABLE, None)
        run_exporter(
            bpy.ops.wm.usd_export,
            path,
            {"selected_objects_only": True, "export_animation": True, "export_materials": True},
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
    require_whole(path)
    progress("exporting USD", 1, 1)
