"""Resting lanes: of joints that nothing measured informs in some frames, an animated property of their bones."""

from __future__ import annotations

import re

import bpy
import numpy as np

from .._exchange.motion_file import MotionFile
from .curves import CurveTarget, action_curves, current_action, key_type_values, write_curves

PROPERTY = "resting"
_BONE_PATH = re.compile(r'pose\.bones\["([^"]+)"\]\["resting"\]')


def write_resting(
    target: CurveTarget, armature: bpy.types.Object, motion: MotionFile, frames: np.ndarray, times: np.ndarray
) -> None:
    """Write 1 where a joint is at rest and 0 elsewhere, for the joints that ever are.

    Args:
        target: the take's action.
        armature: its armature.
        motion: the motion.
        frames: (N,) frames of the motion that get a key.
        times: (F,) scene frame of each frame of the motion.
    """
    for bone in armature.pose.bones:
        if PROPERTY in bone:
            del bone[PROPERTY]  # of another take: without a curve it would stay
    if motion.resting is None:
        return
    types = key_type_values(motion.keyframes, motion.num_frames)[frames]
    for j in np.flatnonzero(motion.resting.any(axis=0)):
        joint = motion.body_layout.joints[j]
        if joint not in armature.pose.bones:
            continue
        bone, share = armature.pose.bones[joint], motion.resting[frames, j : j + 1].astype(np.float64)
        bone[PROPERTY] = 0.0
        bone.id_properties_ui(PROPERTY).update(min=0.0, max=1.0, description="1 where nothing measured the joint")
        write_curves(target, f'pose.bones["{joint}"]["{PROPERTY}"]', joint, times[frames], share, types)


def resting_at(action: bpy.types.Action | None, times: np.ndarray) -> dict[str, np.ndarray]:
    """Return (F,) bool at scene frames, of each bone that has a lane: whether nothing measured its joint."""
    if action is None:
        return {}
    return {
        match[1]: np.array([curve.evaluate(float(time)) > 0.0 for time in times], dtype=bool)
        for curve in action_curves(action)
        if (match := _BONE_PATH.fullmatch(curve.data_path)) is not None
    }


def resting_bones(armature: bpy.types.Object, frame: float) -> frozenset[str]:
    """Return the bones at rest on a scene frame of an armature's take."""
    found = resting_at(current_action(armature), np.array([frame]))
    return frozenset(name for name, rests in found.items() if rests[0])
