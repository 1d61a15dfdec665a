"""Write a motion as an action: rotations of the pose bones, and the path of the pelvis."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import bpy
import numpy as np

from .._exchange.clips import without_root
from .._exchange.ground_path import GroundPath
from .._exchange.motion_file import MotionFile
from .._exchange.progress import Progress, silent
from .._exchange.so3 import quat_from_matrix, quat_from_rotvec, quat_multiply, rotvec_from_quat, sign_continuous
from ..body.armature import rotation_from_body_axes
from ..body.body_file import rotvec_on
from ..body.controls.limbs import LIMBS, ROOT, control_paths, has_limbs, switch_path
from ..conventions.coordinates import QUAT_BODY_ARMATURE
from ..conventions.naming import ROOT_MOTION
from ..conventions.skeleton import SMPL, BodyLayout, layout_of
from ..conventions.timing import TakeTiming
from .curves import CurveTarget, create_action, key_type_values, mark_laid, write_curves
from .key_reduction import thin_channels
from .lanes import write_lanes
from .layers import keep_users_action, reset_root

ROOT_PATHS = tuple(f'pose.bones["{ROOT}"].{name}' for name in ("location", "rotation_quaternion"))
"""Data paths of the root control's location and rotation."""
_EDITED = 1e-4
"""Deviations from the motion above this are hand edits, in metres or quaternion components."""


def bake_action(
    name: str,
    motion: MotionFile,
    armature: bpy.types.Object,
    rest_pelvis: np.ndarray,
    timing: TakeTiming,
    keys_per_second: float | None = None,
    tolerance_mm: float | None = None,
    edited: np.ndarray | None = None,
    progress: Progress = silent,
) -> bpy.types.Action:
    """Write a motion as a new action of an armature and play it.

    Args:
        rest_pelvis: (3,) rest position of the shaped body's pelvis in the body's frame, in metres.
        keys_per_second: average number of keys to keep, connected by smooth curves. The action stores how far the
        result deviates from the full take. None writes a key at every frame.
        tolerance_mm: keep as few keys as possible while every joint stays this close to the full take.
        edited: (F, 3 + 4 J) channels with hand edits, or None to use the motion's channels.
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
            kept = slice(0, 1 if np.ptp(wanted[:, part], axis=0).max() == 0.0 else None)  # one key for constant curves
            write_curves(target, path, joint, times[kept], wanted[kept, part], types[kept])
        keyed = np.arange(motion.num_frames)
    else:
        count = 1 + round((keys_per_second or 0.0) * motion.num_frames / motion.fps)
        places = motion.keyframes
        if edited is not None and places is not None:
            places = places | (np.abs(edited - channels).max(axis=1) > _EDITED)
        curves, deviation = thin_channels(wanted, armature, places, count, tolerance_mm, progress)
        slopes = curves.slopes * motion.fps / timing.scene_fps
        for path, joint, part in columns:
            smooth = times[curves.frames], curves.values[:, part], key_type_values(None, len(curves.frames))
            write_curves(target, path, joint, *smooth, slopes=slopes[:, part])
        keyed = curves.frames
        action["keys_deviation"] = str(deviation)
        action["keys_deviation_mm"], action["keys_deviation_degrees"] = deviation.joints_mm, deviation.degrees
    if motion.root is not None:
        key_root(target, armature, GroundPath.of(motion.root), times)
        action[ROOT_MOTION] = True
    write_lanes(target, armature, motion, keyed, times)
    _key_switches(target, armature, times[:1])
    armature["betas"], armature["rest_pelvis"] = motion.betas.tolist(), rest_pelvis.tolist()
    armature["body"], armature["provenance"] = motion.body, motion.provenance
    mark_laid(action, motion.fps, motion.num_frames, timing.start, timing.scene_fps)
    action["body"] = motion.body
    action["provenance"] = motion.provenance
    action.use_fake_user = True
    return action


def key_root(
    target: CurveTarget, armature: bpy.types.Object, path: GroundPath, times: np.ndarray, metres_a_unit: float = 1.0
) -> None:
    """Key the root control along a path at (F,) scene frames. One armature unit is ``metres_a_unit`` metres."""
    axes = np.array(armature.data.bones[ROOT].matrix_local, np.float64)[:3, :3]
    types = key_type_values(None, len(times))
    armature.pose.bones[ROOT].rotation_mode = "QUATERNION"
    write_curves(target, ROOT_PATHS[0], ROOT, times, path.way @ axes / metres_a_unit, types)
    quaternions = sign_continuous(quat_from_matrix(axes.T @ path.turns @ axes))
    write_curves(target, ROOT_PATHS[1], ROOT, times, quaternions, types)


def _key_switches(target: CurveTarget, armature: bpy.types.Object, start: np.ndarray) -> None:
    """Key the IK switches and finger controls at 0, because a take must not inherit their current values."""
    for path, name in control_paths(armature):
        write_curves(target, path, name, start, np.zeros((1, 3)), key_type_values(None, 1))
    if not has_limbs(armature):
        return
    for limb in LIMBS:
        write_curves(target, switch_path(limb), ROOT, start, np.zeros((1, 1)), key_type_values(None, 1))


def pose_channels(motion: MotionFile, armature: bpy.types.Object, rest_pelvis: np.ndarray) -> np.ndarray:
    """Return (F, 3 + 4 J) channels: the pelvis location in metres, then a quaternion (wxyz) per bone.

    Channels are in the rest axes of each bone, and do not include the motion of the root control.
    """
    motion = without_root(motion)
    rotvec = rotvec_on(motion, layout_of(armature.data.bones))
    quaternions = bone_quaternions(rotvec, rotation_from_body_axes(armature))
    location = _pelvis_location(motion, armature, rest_pelvis)
    return np.concatenate([location, quaternions.reshape(motion.num_frames, -1)], axis=1)


def channel_poses(
    channels: np.ndarray, armature: bpy.types.Object, rest_pelvis: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Convert channels back to axis-angle vectors (F, J, 3) and translations (F, 3)."""
    quat = channels[:, 3:].reshape(len(channels), -1, 4)
    quat = quat / np.linalg.norm(quat, axis=-1, keepdims=True)
    quat[..., 1:] = (np.swapaxes(rotation_from_body_axes(armature), 1, 2) @ quat[..., 1:, None])[..., 0]
    quat[:, 0] = quat_multiply(_CONJUGATE * QUAT_BODY_ARMATURE, quat[:, 0])
    rest = np.array(armature.data.bones[SMPL.joints[0]].matrix_local, dtype=np.float64)
    return rotvec_from_quat(quat), rest[:3, 3] + channels[:, :3] @ rest[:3, :3].T - rest_pelvis


def pose_columns(layout: BodyLayout = SMPL) -> Iterator[tuple[str, str, slice]]:
    """Yield each animated property's data path, its bone name and its columns in ``pose_channels``."""
    pelvis, *_ = layout.joints
    yield f'pose.bones["{pelvis}"].location', pelvis, slice(0, 3)
    for j, joint in enumerate(layout.joints):
        yield f'pose.bones["{joint}"].rotation_quaternion', joint, slice(3 + 4 * j, 7 + 4 * j)


def bone_quaternions(rotvec: np.ndarray, R_bone_body: np.ndarray) -> np.ndarray:
    """Convert (F, J, 3) axis-angle vectors to (F, J, 4) wxyz quaternions with continuous signs.

    An axis-angle vector v in the body's frame is ``C v`` in a bone's axes, where C is the bone's matrix in
    ``R_bone_body`` (J, 3, 3). The root also makes the body upright. The armature is upright already, so this part of
    the root's rotation is removed first.
    """
    quat = quat_from_rotvec(rotvec)
    quat[:, 0] = quat_multiply(QUAT_BODY_ARMATURE, quat[:, 0])
    quat[..., 1:] = (R_bone_body @ quat[..., 1:, None])[..., 0]
    return sign_continuous(quat)


def _pelvis_location(motion: MotionFile, armature: bpy.types.Object, rest_pelvis: np.ndarray) -> np.ndarray:
    rest = np.array(armature.data.bones[SMPL.joints[0]].matrix_local, dtype=np.float64)
    return (rest_pelvis + motion.transl - rest[:3, 3]) @ rest[:3, :3]


_CONJUGATE = np.array([1.0, -1.0, -1.0, -1.0])


@dataclass(frozen=True)
class BodyPose:
    """Pose of an SMPL-type body in one frame."""

    rotvec: np.ndarray  # (J, 3) axis-angle in radians. The root maps body to world, all others child to parent.
    transl: np.ndarray  # (3,) metres: the pelvis is at ``J_0(betas) + transl``.


def read_pose(
    armature: bpy.types.Object,
    rest_pelvis: np.ndarray,
    R_bone_body: np.ndarray | None = None,
    *,
    without_root: bool = False,
) -> BodyPose:
    """Return the evaluated pose of a body, without the root control's motion if ``without_root`` is true.

    Pass ``R_bone_body`` to reuse a result of ``rotation_from_body_axes``.
    """
    R_bone_body = rotation_from_body_axes(armature) if R_bone_body is None else R_bone_body
    bones = [armature.pose.bones[joint] for joint in layout_of(armature.data.bones).joints]
    spaces = {"from_space": "POSE", "to_space": "LOCAL"}
    local = [armature.convert_space(pose_bone=bone, matrix=bone.matrix, **spaces) for bone in bones]
    if not without_root:
        local[0] = bones[0].bone.matrix_local.inverted() @ bones[0].matrix
    quat = np.array([matrix.to_quaternion() for matrix in local], dtype=np.float64)
    quat[:, 1:] = (np.swapaxes(R_bone_body, 1, 2) @ quat[:, 1:, None])[..., 0]
    quat[0] = quat_multiply(_CONJUGATE * QUAT_BODY_ARMATURE, quat[0])
    pelvis = np.array((bones[0].bone.matrix_local @ local[0]).translation, dtype=np.float64)
    return BodyPose(rotvec_from_quat(quat), pelvis - rest_pelvis)
