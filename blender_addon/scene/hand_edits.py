"""Find hand edits in a take: differences between the body's pose and its motion file."""

from __future__ import annotations

from collections.abc import Sequence

import bpy
import numpy as np

from .._exchange.motion_file import MotionFile, read_motion
from .._exchange.progress import Progress, silent
from .._exchange.so3 import quat_from_matrix, sign_continuous
from ..animation.action import pose_channels, pose_columns
from ..animation.curves import action_curves, curve_values, is_take, laid_rate
from ..animation.key_reduction import SparseCurves, posed_joints, rest_of
from ..animation.layers import without_layers
from ..animation.takes import take_file
from ..body.body_file import body_path_of, read_body, with_own_hands
from ..body.controls.limbs import LIMBS, ROOT, control_paths, has_limbs, switch_path
from ..conventions.skeleton import layout_of
from ..conventions.timing import TakeTiming
from .limb_modes import own_channels, sample_bones

_TURN = 2.5e-3
"""Smallest Frobenius norm of a rotation difference that is an edit (0.1 degrees). Rounding and IK cause a tenth."""
_MOVE_M = 5e-4  # Smallest pelvis movement in metres that is an edit.


def edited_frames(
    scene: bpy.types.Scene, armature: bpy.types.Object, take: bpy.types.Action, first: int, last: int
) -> np.ndarray:
    """Return the take's frames from first to last (counted from 0) that were edited."""
    motion = read_motion(take_file(take, "motion_file"))
    frames = np.arange(max(first, 0), min(last, motion.num_frames - 1) + 1)
    if not len(frames):
        return frames
    joints = layout_of(armature.data.bones).joints
    with without_layers(armature):
        seen = _sample_without_root(armature, scene, joints, take_times(take, motion)[frames])
    found = np.stack([seen[joint] for joint in joints], axis=1)
    channels = _baked_channels(take, motion, armature)[frames]
    G, p = posed_joints(channels, *rest_of(armature))
    turned = np.linalg.norm(found[..., :3, :3] - G, axis=(-2, -1)).max(axis=1)
    moved = np.linalg.norm(found[:, 0, :3, 3] - p[:, 0], axis=-1)
    return frames[(turned > _TURN) | (moved > _MOVE_M)]


def take_times(take: bpy.types.Action, motion: MotionFile) -> np.ndarray:
    """Return the scene frames (F,) at which a take shows the frames of its motion."""
    return TakeTiming(float(take["frame_start"]), laid_rate(take)).scene_frames(motion.num_frames, motion.fps)


def played_channels(
    scene: bpy.types.Scene, armature: bpy.types.Object, times: np.ndarray, progress: Progress = silent
) -> np.ndarray:
    """Return the channels (F, 3 + 4 J) of the poses that a body plays at (F,) scene frames."""
    own = armature.animation_data.action  # a take on the NLA is sampled, because its strip may have been moved
    curves = {(c.data_path, c.array_index): c for c in (action_curves(own) if own is not None and is_take(own) else ())}
    if not _poses_from_ends(armature, curves):
        places = pose_columns(layout_of(armature.data.bones))
        columns = [(path, index) for path, _, part in places for index in range(part.stop - part.start)]
        return np.stack([curve_values(curves[place], times) for place in columns], axis=1)
    return seen_channels(scene, armature, times, progress)


def _baked_channels(take: bpy.types.Action, motion: MotionFile, armature: bpy.types.Object) -> np.ndarray:
    body = read_body(body_path_of(motion.provenance), motion.body_layout)
    channels = pose_channels(with_own_hands(motion, body), armature, body.rest_joints(motion.betas)[0])
    path, _, _ = next(pose_columns())
    curve = next((c for c in action_curves(take) if c.data_path == path), None)
    keys = () if curve is None else [point.co.x for point in curve.keyframe_points]
    step = take_times(take, motion)[:2]
    at = np.rint((np.array(keys) - step[0]) / np.ptp(step)).astype(int) if len(step) > 1 else np.zeros(0, int)
    at = np.unique(at[(at >= 0) & (at < motion.num_frames)])
    if len(at) < 2 or len(at) == motion.num_frames:
        return channels
    at = np.union1d(at, [0, motion.num_frames - 1])
    return SparseCurves.fitted(channels, at).sampled(motion.num_frames)


def _poses_from_ends(armature: bpy.types.Object, curves: dict[tuple[str, int], bpy.types.FCurve]) -> bool:
    """Return whether joint curves do not define the whole pose: IK or finger controls act, or a curve is missing."""
    if any((path, 0) not in curves for path, _, _ in pose_columns(layout_of(armature.data.bones))):
        return True
    if _turns_finger_controls(armature, curves):
        return True
    if not has_limbs(armature):
        return False
    switches = [(limb, curves.get((switch_path(limb), 0))) for limb in LIMBS]
    return any(
        armature.pose.bones[ROOT][limb.switch] > 0 if curve is None else any(p.co.y > 0 for p in curve.keyframe_points)
        for limb, curve in switches
    )


def _turns_finger_controls(armature: bpy.types.Object, curves: dict[tuple[str, int], bpy.types.FCurve]) -> bool:
    for path, name in control_paths(armature):
        for axis in (0, 2):
            values = [armature.pose.bones[name].rotation_euler[axis]]
            if (curve := curves.get((path, axis))) is not None:
                values = [point.co.y for point in curve.keyframe_points]
            if any(abs(value) > 1e-6 for value in values):
                return True
    return False


def seen_channels(
    scene: bpy.types.Scene, armature: bpy.types.Object, times: np.ndarray | None, progress: Progress = silent
) -> np.ndarray:
    """Return the channels (F, 3 + 4 J) of evaluated poses, at given scene frames or in the current frame."""
    bones = armature.data.bones
    pelvis, *others = layout_of(bones).joints
    seen = _sample_without_root(armature, scene, (pelvis, *others), times, progress)
    first = np.linalg.inv(np.array(bones[pelvis].matrix_local, np.float64)) @ seen[pelvis]
    local = [first, *(own_channels(armature, name, seen[name], seen[bones[name].parent.name]) for name in others)]
    quaternions = sign_continuous(quat_from_matrix(np.stack(local, axis=1)[..., :3, :3]))
    return np.concatenate([first[:, :3, 3], quaternions.reshape(len(first), -1)], axis=1)


def _sample_without_root(
    armature: bpy.types.Object,
    scene: bpy.types.Scene,
    names: Sequence[str],
    times: np.ndarray | None,
    progress: Progress = silent,
) -> dict[str, np.ndarray]:
    """Return ``sample_bones`` without the motion that the root control adds to the whole take."""
    seen = sample_bones(armature, scene, (ROOT, *names), times, progress)
    back = np.array(armature.data.bones[ROOT].matrix_local, np.float64) @ np.linalg.inv(seen[ROOT])
    return {name: back @ seen[name] for name in names}
