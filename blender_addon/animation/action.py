"""The action: the motion as rotations of the pose bones and the path of the pelvis."""

from __future__ import annotations

from collections.abc import Iterator

import bpy
import numpy as np

from .._exchange.motion_file import MotionFile
from .._exchange.so3 import quat_from_rotvec, quat_multiply, sign_continuous
from ..body.armature import rotation_from_body_axes
from ..body.controls.limbs import LIMBS, ROOT, control_paths, has_limbs, switch_path
from ..body.posed_body import rotvec_on
from ..conventions.coordinates import QUAT_BODY_ARMATURE
from ..conventions.skeleton import SMPL, BodyLayout, layout_of
from ..conventions.timing import TakeTiming
from .curves import CurveTarget, create_action, key_type_values, write_curves, write_smooth_curves
from .key_reduction import thin_channels
from .lanes import write_confidence, write_resting
from .layers import keep_users_action, reset_root
from .retiming import mark_laid

_EDITED = 1e-4
"""Difference of a channel (metres, or parts of a quaternion) from the motion's that was made by hand."""


def bake_action(
    name: str,
    motion: MotionFile,
    armature: bpy.types.Object,
    rest_pelvis: np.ndarray,
    timing: TakeTiming,
    keys_per_second: float | None = None,
    tolerance_mm: float | None = None,
    edited: np.ndarray | None = None,
) -> bpy.types.Action:
    """Write the motion as one new action of the armature.

    Args:
        name: name of the action.
        motion: the motion.
        armature: of the body's rig.
        rest_pelvis: (3,) pelvis of the shaped body in the body's frame.
        timing: where the take lies in the scene.
        keys_per_second: about how many of the solver's keys to keep, joined by smooth curves; how far that is from
            the full take is noted on the action. None for a key on every frame.
        tolerance_mm: instead of that, as few keys as leave every joint so near to the full take.
        edited: (F, 3 + 4 J) channels to write, with what was changed by hand; None for the motion's own.
    """
    with keep_users_action(armature):
        target = create_action(name, armature)
    if edited is None:
        reset_root(armature)
    action, times = target.action, timing.scene_frames(motion.num_frames, motion.fps)
    channels, columns = pose_channels(motion, armature, rest_pelvis), [*pose_columns(layout_of(armature.data.bones))]
    wanted = channels if edited is None else edited
    if keys_per_second is None and tolerance_mm is None:
        types = key_type_values(motion.keyframes, motion.num_frames)
        for path, joint, part in columns:
            kept = _needed(wanted[:, part])
            write_curves(target, path, joint, times[kept], wanted[kept, part], types[kept])
        write_confidence(target, armature, motion, np.arange(motion.num_frames), times)
        write_resting(target, armature, motion, np.arange(motion.num_frames), times)
    else:
        count = 1 + round((keys_per_second or 0.0) * motion.num_frames / motion.fps)
        places = motion.keyframes
        if edited is not None and places is not None:
            places = places | (np.abs(edited - channels).max(axis=1) > _EDITED)
        curves, deviation = thin_channels(wanted, armature, places, count, tolerance_mm)
        slopes = curves.slopes * motion.fps / timing.scene_fps
        for path, joint, part in columns:
            write_smooth_curves(target, path, joint, times[curves.frames], curves.values[:, part], slopes[:, part])
        write_confidence(target, armature, motion, curves.frames, times)
        write_resting(target, armature, motion, curves.frames, times)
        action["keys_deviation"] = str(deviation)
        action["keys_deviation_mm"], action["keys_deviation_degrees"] = deviation.joints_mm, deviation.degrees
    _key_switches(target, armature, times[:1])
    armature["betas"], armature["rest_pelvis"] = motion.betas.tolist(), rest_pelvis.tolist()
    armature["body"], armature["provenance"] = motion.body, motion.provenance
    mark_laid(action, motion.fps, motion.num_frames, timing.start, timing.scene_fps)
    action["body"] = motion.body
    action["provenance"] = motion.provenance
    action.use_fake_user = True
    return action


def _needed(values: np.ndarray) -> slice:
    """Return which of (F, C) values are keyed: all, or where nothing ever changes (hands not solved) the first."""
    return slice(0, 1 if np.ptp(values, axis=0).max() == 0.0 else None)


def _key_switches(target: CurveTarget, armature: bpy.types.Object, start: np.ndarray) -> None:
    """Key switches of limbs to FK and finger controls to 0: takes shown in turn do not inherit another's."""
    for path, name in control_paths(armature):
        write_curves(target, path, name, start, np.zeros((1, 3)), key_type_values(None, 1))
    if not has_limbs(armature):
        return
    for limb in LIMBS:
        write_curves(target, switch_path(limb), ROOT, start, np.zeros((1, 1)), key_type_values(None, 1))


def pose_channels(motion: MotionFile, armature: bpy.types.Object, rest_pelvis: np.ndarray) -> np.ndarray:
    """Return the (F, 3 + 4 J) location of the pelvis and quaternions wxyz of the bones, in their own rest axes."""
    rotvec = rotvec_on(motion, layout_of(armature.data.bones))
    quaternions = bone_quaternions(rotvec, rotation_from_body_axes(armature))
    location = pelvis_location(motion, armature, rest_pelvis)
    return np.concatenate([location, quaternions.reshape(motion.num_frames, -1)], axis=1)


def pose_columns(layout: BodyLayout = SMPL) -> Iterator[tuple[str, str, slice]]:
    """Yield data path, bone and columns of each property in ``pose_channels``."""
    pelvis, *_ = layout.joints
    yield f'pose.bones["{pelvis}"].location', pelvis, slice(0, 3)
    for j, joint in enumerate(layout.joints):
        yield f'pose.bones["{joint}"].rotation_quaternion', joint, slice(3 + 4 * j, 7 + 4 * j)


def bone_quaternions(rotvec: np.ndarray, R_bone_body: np.ndarray) -> np.ndarray:
    """Return the pose-bone rotations of a motion, continuous in sign.

    A joint's rotation exp(v) in the body's axes is exp(C v) in its bone's axes. The root maps the body's frame to the
    world; the armature's frame already is the world's, so the part that stands the body up is taken off first.

    Args:
        rotvec: (F, J, 3) axis-angle in radians.
        R_bone_body: (J, 3, 3) rotations C from ``rotation_from_body_axes``.

    Returns:
        (F, J, 4) wxyz.
    """
    quat = quat_from_rotvec(rotvec)
    quat[:, 0] = quat_multiply(QUAT_BODY_ARMATURE, quat[:, 0])
    quat[..., 1:] = (R_bone_body @ quat[..., 1:, None])[..., 0]
    return sign_continuous(quat)


def pelvis_location(motion: MotionFile, armature: bpy.types.Object, rest_pelvis: np.ndarray) -> np.ndarray:
    """Return the (F, 3) location channel of the pelvis: its path in its own rest axes, in metres."""
    rest = np.array(armature.data.bones[SMPL.joints[0]].matrix_local, dtype=np.float64)
    return (rest_pelvis + motion.transl - rest[:3, 3]) @ rest[:3, :3]
