"""Read the motion that a take plays, add takes from edited motions (clips), and save poses as assets."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import bpy
import numpy as np

from .._exchange.clips import turn_covariance, unobserved
from .._exchange.motion_file import MotionFile, read_motion, write_motion
from .._exchange.so3 import matrix_from_rotvec, rotvec_from_matrix
from ..animation.action import ROOT_PATHS, bake_action, channel_poses, pose_columns
from ..animation.curves import action_curves, curve_target, key_type_values, write_curves
from ..animation.layers import without_layers
from ..animation.takes import BETAS, PERSON, SolveFiles, measured_key, show_take, take_file
from ..body.body_file import body_path_of, pose_joints, read_body, require_body, with_own_hands
from ..body.controls.limbs import ROOT
from ..conventions.naming import CLIP, next_path
from ..conventions.skeleton import BodyLayout, layout_of
from ..conventions.timing import TakeTiming, scene_frame_rate, show_frame
from .hand_edits import played_channels, seen_channels, take_times
from .limb_modes import sample_bones

_MOVED_M = 1e-3  # Joint distance from the motion file in metres above which observations are dropped.


def played_motion(
    scene: bpy.types.Scene, armature: bpy.types.Object, take: bpy.types.Action, *, with_place: bool = False
) -> MotionFile:
    """Return the motion of a body's take with the user's edits, but without the user's layers on top of the take.

    Keys on the root control move the motion. ``with_place`` also applies a root transform that is not keyed. If edits
    moved any joint, the motion loses its camera and marker observations. The result has the armature's joints.
    """
    motion = read_motion(take_file(take, "motion_file"), whole=True)
    layout = layout_of(armature.data.bones)
    body = read_body(body_path_of(motion.provenance), layout)
    require_body(motion, body)
    motion = on_layout(with_own_hands(motion, body), layout)
    rest, times = body.rest_joints(motion.betas), take_times(take, motion)
    with without_layers(armature):
        rotvec, transl = channel_poses(played_channels(scene, armature, times), armature, rest[0])
        way = _root_ways(scene, armature, times) if with_place or _keys_root(take) else None
    solved = pose_joints(rest, motion.rotvec, motion.transl)[1]
    if way is not None:
        turn = way[:, :3, :3]
        transl = (turn @ (rest[0] + transl)[..., None])[..., 0] + way[:, :3, 3] - rest[0]
        rotvec[:, 0] = rotvec_from_matrix(turn @ matrix_from_rotvec(rotvec[:, 0]))
        if motion.joint_covariance is not None:
            motion = replace(motion, joint_covariance=turn_covariance(motion.joint_covariance, turn[:, None]))
        if motion.root is not None:
            heading = np.unwrap(np.arctan2(way[:, 1, 0], way[:, 0, 0]))
            motion = replace(motion, root=np.column_stack([way[:, :2, 3], heading]))
    joints = pose_joints(rest, rotvec, transl)[1]
    if np.abs(joints - solved).max() > _MOVED_M:
        motion = unobserved(motion)
    return replace(motion, rotvec=rotvec, transl=transl, joints=joints)


def _keys_root(take: bpy.types.Action) -> bool:
    return any(curve.data_path in ROOT_PATHS for curve in action_curves(take))


def _root_ways(scene: bpy.types.Scene, armature: bpy.types.Object, times: np.ndarray) -> np.ndarray:
    """Return (F, 4, 4) transforms of the root control relative to its rest pose, in the armature's frame."""
    rest = np.array(armature.data.bones[ROOT].matrix_local, np.float64)
    return sample_bones(armature, scene, (ROOT,), times)[ROOT] @ np.linalg.inv(rest)


def on_layout(motion: MotionFile, layout: BodyLayout) -> MotionFile:
    """Convert a motion to the joints of a layout. Fingers that the motion lacks are at rest."""
    if motion.body_layout.joints == layout.joints:
        return motion
    own, columns = motion.body_layout.joints, list[int]()
    for j, joint in enumerate(layout.joints):
        columns.append(own.index(joint) if joint in own else columns[layout.parents[j]])
    fields: dict[str, Any] = {
        name: None if (value := getattr(motion, name)) is None else value[:, columns]
        for name in ("joint_sigma", "joint_covariance", "resting")
    }
    turned = np.array([joint in own for joint in layout.joints])
    rotvec = motion.rotvec[:, columns] * turned[:, None]
    return replace(motion, rotvec=rotvec, body_layout=layout, joints=None, **fields)


def add_clip(
    scene: bpy.types.Scene,
    armature: bpy.types.Object,
    take: bpy.types.Action,
    word: str,
    edit: Callable[[MotionFile], MotionFile],
    *,
    with_place: bool = False,
) -> bpy.types.Action:
    """Edit a take's motion, write the result to a new motion file, and play it as a new take.

    If the root control has no keys, it keeps its transform. See ``played_motion`` for ``with_place``.
    """
    source = take_file(take, "motion_file")
    motion = edit(played_motion(scene, armature, take, with_place=with_place))
    root = None if with_place or _keys_root(take) else armature.pose.bones.get(ROOT)
    place = None if root is None else root.matrix_basis.copy()
    path = next_path(source.parent, f"{source.stem}_{word.replace(' ', '_')}", ".npz")
    write_motion(path, motion)
    rest_pelvis = read_body(body_path_of(motion.provenance), motion.body_layout).rest_joints(motion.betas)[0]
    timing = TakeTiming(int(take["frame_start"]), scene_frame_rate(scene))
    action = bake_action(f"{take.name} {word}", motion, armature, rest_pelvis, timing)
    SolveFiles(path, take_file(take, measured_key(take)), None, None).write(action)
    action[CLIP], action[BETAS] = take.name, motion.betas.tolist()
    if PERSON in take:
        action[PERSON] = take[PERSON]
    if root is not None:
        root.matrix_basis = place  # before the take is shown, because this becomes its place
    show_take(armature, action)
    show_frame(scene)
    return action


def add_pose(scene: bpy.types.Scene, armature: bpy.types.Object) -> bpy.types.Action:
    """Add a one-frame action with a body's current pose, marked as an asset."""
    action = bpy.data.actions.new(f"{armature.name} pose")
    slot = action.slots.new(id_type="OBJECT", name=armature.name) if hasattr(action, "slots") else None
    target = curve_target(action, slot)
    assert target is not None, "the action has a slot"
    channels, types = seen_channels(scene, armature, None), key_type_values(None, 1)
    for path, joint, part in pose_columns(layout_of(armature.data.bones)):
        write_curves(target, path, joint, np.zeros(1), channels[:, part], types)
    action.use_fake_user = True
    action.asset_mark()
    action.asset_data.tags.new("pose", skip_if_exists=True)
    return action
