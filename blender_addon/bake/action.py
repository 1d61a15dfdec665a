"""The action: the motion as rotations of the pose bones and the path of the pelvis."""

from __future__ import annotations

import bpy
import numpy as np

from ..files.motion_file import MotionFile
from ..files.skeleton import JOINTS
from .armature import rotation_from_body_axes
from .coordinates import QUAT_BODY_ARMATURE
from .curves import create_action, key_type_values, write_curves
from .rotations import quat_from_rotvec, quat_multiply, sign_continuous
from .timing import TakeTiming


def bake_action(
    name: str, motion: MotionFile, armature: bpy.types.Object, rest_pelvis: np.ndarray, timing: TakeTiming
) -> bpy.types.Action:
    """Write the motion as one new action of the armature.

    Args:
        name: name of the action.
        motion: the motion.
        armature: from ``create_armature``.
        rest_pelvis: (3,) pelvis of the shaped body in the body's frame.
        timing: where the take lies in the scene.
    """
    target = create_action(name, armature)
    times = timing.scene_frames(motion.num_frames, motion.fps)
    types = key_type_values(motion.keyframes, motion.num_frames)
    location = pelvis_location(motion, armature, rest_pelvis)
    write_curves(target, 'pose.bones["pelvis"].location', JOINTS[0], times, location, types)
    quaternions = bone_quaternions(motion.rotvec, rotation_from_body_axes(armature))
    for j, joint in enumerate(JOINTS):
        write_curves(target, f'pose.bones["{joint}"].rotation_quaternion', joint, times, quaternions[:, j], types)
    target.action["fps"] = motion.fps
    target.action["body"] = motion.body
    target.action["provenance"] = motion.provenance
    target.action.use_fake_user = True
    return target.action


def bone_quaternions(rotvec: np.ndarray, R_bone_body: np.ndarray) -> np.ndarray:
    """Return the pose-bone rotations of a motion, continuous in sign.

    A joint's rotation exp(v) in the body's axes is exp(C v) in its bone's axes. The root maps the body's frame to the
    world; the armature's frame already is the world's, so the part that stands the body up is taken off first.

    Args:
        rotvec: (F, 24, 3) axis-angle in radians.
        R_bone_body: (24, 3, 3) rotations C from ``rotation_from_body_axes``.

    Returns:
        (F, 24, 4) wxyz.
    """
    quat = quat_from_rotvec(rotvec)
    quat[:, 0] = quat_multiply(QUAT_BODY_ARMATURE, quat[:, 0])
    quat[..., 1:] = (R_bone_body @ quat[..., 1:, None])[..., 0]
    return sign_continuous(quat)


def pelvis_location(motion: MotionFile, armature: bpy.types.Object, rest_pelvis: np.ndarray) -> np.ndarray:
    """Return the (F, 3) location channel of the pelvis: its path in its own rest axes, in metres."""
    rest = np.array(armature.data.bones[JOINTS[0]].matrix_local, dtype=np.float64)
    return (rest_pelvis + motion.transl - rest[:3, 3]) @ rest[:3, :3]
