"""A known motion of our body on a character of another program, and that as a file of its clips."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np

from blender_addon._exchange.motion_file import MotionFile
from blender_addon.body.body_file import default_body_path, read_body
from blender_addon.conventions.timing import TakeTiming
from blender_addon.retarget.motion.figures import actor_of_motion
from blender_addon.retarget.motion.transfer import TransferSettings
from blender_addon.retarget.recognition import map_rig
from blender_addon.retarget.retarget import RetargetSettings, retarget
from solver_backend.body.body import load_body
from solver_backend.synthesis.embedded.demo import author_motion
from tests.support.foreign_characters import skinned_rig
from tests.support.own_skeleton import own_skeleton

BETAS = np.array([0.8, -0.5, 0.6, 0.9, 0.3, 0.0, 0.0, 0.0, 0.0, 0.0])
FRAMES, FPS = 60, 30.0


def known_clip() -> MotionFile:
    """Return the motion."""
    own = author_motion(load_body(), BETAS, FRAMES, FPS)
    pose = np.zeros((FRAMES, 24, 3))
    pose[:, 0], pose[:, 1:22] = own.global_orient, own.body_pose.reshape(FRAMES, -1, 3)[:, :21]
    return MotionFile("walk", pose, own.transl, BETAS, FPS)


def play_on_character(motion: MotionFile, scene: bpy.types.Scene) -> bpy.types.Object:
    """Lay the motion on a character of the body's proportions, with a skin, and return that."""
    body = read_body(default_body_path())
    rig = skinned_rig(own_skeleton(body, BETAS))
    scene.render.fps, scene.frame_end = int(FPS), FRAMES
    exact = RetargetSettings(transfer=TransferSettings(hold_contacts=False))  # feet glide as in the clip
    retarget(actor_of_motion(motion, body), rig, scene, map_rig(rig), TakeTiming(1, FPS), exact)
    return rig


def write_clip(path: Path) -> Path:
    """Write the scene in the format that the name ends on."""
    if path.suffix == ".fbx":
        bpy.ops.export_scene.fbx(
            filepath=str(path), add_leaf_bones=False, bake_anim_use_all_actions=False, bake_anim_use_nla_strips=False,
            bake_anim_simplify_factor=0.0,
        )  # fmt: skip
    else:
        bpy.ops.export_scene.gltf(filepath=str(path), export_force_sampling=True, export_optimize_animation_size=False)
    return path
