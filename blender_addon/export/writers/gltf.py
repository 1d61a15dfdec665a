"""glTF (binary) by Blender's exporter: metres, Y up, deforming bones, every frame a key, time from zero."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..._exchange.progress import Progress
from ..plain_take import plain_take
from ..take import ExportTake, chosen
from .blender_exporters import run_exporter


def export_gltf(path: Path, take: ExportTake, progress: Progress) -> None:
    """Write the armature, its meshes and the motion."""
    progress("exporting glTF", 0, 1)
    with plain_take(take, progress) as plain, chosen(plain) as scene:
        # The exporter takes fps * fps_base for the frame rate, which is fps / fps_base.
        scene.render.fps_base = 1 / scene.render.fps_base
        run_exporter(
            bpy.ops.export_scene.gltf,
            path,
            {
                "use_selection": True,
                "export_format": "GLB",
                "export_yup": True,
                "export_animations": True,
                "export_animation_mode": "SCENE",
                "export_anim_scene_split_object": False,
                "export_anim_slide_to_zero": True,
                "export_force_sampling": True,
                "export_optimize_animation_size": False,
                "export_def_bones": True,
                "export_influence_nb": 4,
            },
            {"export_leaf_bone": False},
        )
    progress("exporting glTF", 1, 1)
