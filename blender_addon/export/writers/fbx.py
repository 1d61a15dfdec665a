"""FBX by Blender's exporter: metres or centimetres as the file's unit, deforming bones without leaves, every frame."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..._exchange.progress import Progress
from ..plain_take import plain_take
from ..take import ExportTake, chosen
from .blender_exporters import run_exporter

_FORWARD = {"Y": "-Z", "Z": "Y"}
"""Blender's Y by the axis that points up."""


def export_fbx(path: Path, take: ExportTake, progress: Progress) -> None:
    """Write the armature, its meshes and the motion."""
    progress("exporting FBX", 0, 1)
    with plain_take(take, progress) as plain, chosen(plain):
        run_exporter(
            bpy.ops.export_scene.fbx,
            path,
            {
                "use_selection": True,
                "object_types": {"ARMATURE", "MESH"},
                # The unit as the file's own, so that no object is scaled.
                "apply_scale_options": "FBX_SCALE_ALL",
                "axis_forward": _FORWARD[take.layout.up],
                "axis_up": take.layout.up,
                "use_mesh_modifiers": False,
                "add_leaf_bones": False,
                "use_armature_deform_only": True,
                "bake_anim": True,
                "bake_anim_use_nla_strips": False,
                "bake_anim_use_all_actions": False,
                "bake_anim_force_startend_keying": True,
                "bake_anim_simplify_factor": 0.0,
            },
        )
    progress("exporting FBX", 1, 1)
