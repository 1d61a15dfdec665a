"""Confidence lanes: a custom property of the armature, the worst joint's, and one of each bone, all animated."""

from __future__ import annotations

import re

import bpy
import numpy as np

from .._exchange.motion_file import MotionFile
from .confidence import joint_confidence
from .curves import CurveTarget, action_curves, key_type_values, write_curves

PROPERTY = "confidence"
_PATH = f'["{PROPERTY}"]'
_BONE_PATH = re.compile(r'pose\.bones\["([^"]+)"\]\["confidence"\]')
_GROUP = "Confidence"


def write_confidence(
    target: CurveTarget, armature: bpy.types.Object, motion: MotionFile, frames: np.ndarray, times: np.ndarray
) -> None:
    """Write the lanes of a motion that knows its uncertainty; bones keep theirs in their own channel groups.

    The armature's lane leaves out joints at rest, which nothing measured informs: they are not what deserves a look.

    Args:
        target: the take's action.
        armature: its armature.
        motion: the motion.
        frames: (N,) frames of the motion that get a key.
        times: (F,) scene frame of each frame of the motion.
    """
    if motion.joint_sigma is None:
        return
    confidence = joint_confidence(motion.joint_sigma, motion.flags)[frames]
    worst = confidence if motion.resting is None else np.where(motion.resting[frames], 1.0, confidence)
    types = key_type_values(motion.keyframes, motion.num_frames)[frames]
    _declare(armature, "Confidence of the least certain joint, 0 to 1")
    write_curves(target, _PATH, _GROUP, times[frames], worst.min(axis=1, keepdims=True), types)
    for j, joint in enumerate(motion.body_layout.joints):
        if joint not in armature.pose.bones:
            continue
        _declare(armature.pose.bones[joint], "Confidence of the joint at this bone's head, 0 to 1")
        write_curves(target, f'pose.bones["{joint}"]{_PATH}', joint, times[frames], confidence[:, j : j + 1], types)


def read_lane(action: bpy.types.Action) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the scene frames (F,) and the confidence (F,) of the worst joint, None if the action has no lane."""
    curve = next((c for c in action_curves(action) if c.data_path == _PATH), None)
    if curve is None:
        return None
    points = np.empty(2 * len(curve.keyframe_points), np.float32)
    curve.keyframe_points.foreach_get("co", points)
    return points[::2].astype(np.float64), points[1::2].astype(np.float64)


def confidence_at(action: bpy.types.Action, frame: float) -> dict[str, float]:
    """Return each bone's confidence on a scene frame, for bones that have a lane."""
    return {
        match[1]: curve.evaluate(frame)
        for curve in action_curves(action)
        if (match := _BONE_PATH.fullmatch(curve.data_path)) is not None
    }


def current_confidence(armature: bpy.types.Object) -> dict[str, float]:
    """Return each bone's confidence on the scene's current frame, for bones that have one."""
    return {bone.name: float(bone[PROPERTY]) for bone in armature.pose.bones if PROPERTY in bone}


def _declare(owner: bpy.types.Object | bpy.types.PoseBone, description: str) -> None:
    owner[PROPERTY] = 1.0
    owner.id_properties_ui(PROPERTY).update(min=0.0, max=1.0, description=description)
