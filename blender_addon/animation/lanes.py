"""Confidence as animated custom properties: one per bone, and the worst joint's on the armature."""

from __future__ import annotations

import re

import bpy
import numpy as np

from .._exchange.motion_file import FLAG_UNSEEN, FLAG_UNSURE, MotionFile
from .curves import CurveTarget, action_curves, current_action, key_type_values, write_curves

HALF_AT_M = 0.03  # Standard deviation at which confidence is one half.
_UNSURE_AT_MOST = 0.3  # Highest confidence of a flagged frame, 0 to 1, chosen by hand.


def joint_confidence(sigma_m: np.ndarray, flags: np.ndarray | None) -> np.ndarray:
    """Return ``1 / (1 + (sigma / 3 cm)²)``, 0 in interpolated frames and at most 0.3 in frames with a large residual.

    Args:
        sigma_m: (F, 24) standard deviations in metres.
        flags: (F,) bit mask of the motion file, or None.
    """
    confidence = 1.0 / (1.0 + (np.asarray(sigma_m, np.float64) / HALF_AT_M) ** 2)
    if flags is not None:
        unsure, unseen = (flags & FLAG_UNSURE) > 0, (flags & FLAG_UNSEEN) > 0
        confidence[unsure] = np.minimum(confidence[unsure], _UNSURE_AT_MOST)
        confidence[unseen] = 0.0
    return confidence


def sigma_of(confidence: float) -> float:
    """Return the standard deviation in metres of a confidence in (0, 1]."""
    return float(HALF_AT_M * np.sqrt(1.0 / max(confidence, 1e-6) - 1.0))


PROPERTY = "confidence"
_PATH = f'["{PROPERTY}"]'
_BONE_PATH = re.compile(r'pose\.bones\["([^"]+)"\]\["confidence"\]')
_GROUP = "Confidence"


def write_confidence(
    target: CurveTarget, armature: bpy.types.Object, motion: MotionFile, frames: np.ndarray, times: np.ndarray
) -> None:
    """Write the confidence of a motion that knows its uncertainty.

    The armature's value leaves out joints at rest, which no measurement informs and nobody needs to review.

    Args:
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
    bones = armature.pose.bones
    for j, joint in ((j, joint) for j, joint in enumerate(motion.body_layout.joints) if joint in bones):
        _declare(bones[joint], "Confidence of the joint at this bone's head, 0 to 1")
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
    """Return the confidence of each bone with a curve on a scene frame."""
    return {
        match[1]: curve.evaluate(frame)
        for curve in action_curves(action)
        if (match := _BONE_PATH.fullmatch(curve.data_path)) is not None
    }


def current_confidence(armature: bpy.types.Object) -> dict[str, float]:
    """Return the confidence of each bone that has one on the scene's current frame."""
    return {bone.name: float(bone[PROPERTY]) for bone in armature.pose.bones if PROPERTY in bone}


def _declare(owner: bpy.types.Object | bpy.types.PoseBone, description: str) -> None:
    owner[PROPERTY] = 1.0
    owner.id_properties_ui(PROPERTY).update(min=0.0, max=1.0, description=description)


RESTING = "resting"
_RESTING_PATH = re.compile(r'pose\.bones\["([^"]+)"\]\["resting"\]')


def write_resting(
    target: CurveTarget, armature: bpy.types.Object, motion: MotionFile, frames: np.ndarray, times: np.ndarray
) -> None:
    """Write 1 for a joint at rest and 0 otherwise, for joints that are ever at rest. See ``write_confidence``."""
    for bone in armature.pose.bones:
        if RESTING in bone:
            del bone[RESTING]  # of another take, which no curve would change
    if motion.resting is None:
        return
    types = key_type_values(motion.keyframes, motion.num_frames)[frames]
    for j in np.flatnonzero(motion.resting.any(axis=0)):
        joint = motion.body_layout.joints[j]
        if joint not in armature.pose.bones:
            continue
        bone, share = armature.pose.bones[joint], motion.resting[frames, j : j + 1].astype(np.float64)
        bone[RESTING] = 0.0
        bone.id_properties_ui(RESTING).update(min=0.0, max=1.0, description="1 where nothing measured the joint")
        write_curves(target, f'pose.bones["{joint}"]["{RESTING}"]', joint, times[frames], share, types)


def resting_at(action: bpy.types.Action | None, times: np.ndarray) -> dict[str, np.ndarray]:
    """Return (F,) bool at scene frames for each bone with a curve: whether nothing measured its joint."""
    if action is None:
        return {}
    return {
        match[1]: np.array([curve.evaluate(float(time)) > 0.0 for time in times], dtype=bool)
        for curve in action_curves(action)
        if (match := _RESTING_PATH.fullmatch(curve.data_path)) is not None
    }


def resting_bones(armature: bpy.types.Object, frame: float) -> frozenset[str]:
    """Return the bones at rest on a scene frame of an armature's take."""
    found = resting_at(current_action(armature), np.array([frame]))
    return frozenset(name for name, rests in found.items() if rests[0])
