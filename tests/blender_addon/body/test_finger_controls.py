"""One control a finger, one a hand: they curl and spread what joints are keyed to, and leave with every take."""

from __future__ import annotations

from itertools import pairwise, product

import bpy
import numpy as np
import pytest

from blender_addon._exchange.body_layout import SMPL_HANDS
from blender_addon._exchange.joint_sets import FINGERS
from blender_addon.animation.action import read_pose
from blender_addon.animation.deviation import evaluated_joints
from blender_addon.body.body_file import default_body_path, pose_joints, read_body
from blender_addon.body.controls.limbs import FINGER_CONTROLS as CONTROLS
from blender_addon.body.controls.limbs import finger_control, fist_control, has_finger_controls
from blender_addon.body.rig import create_rig
from blender_addon.export.take import take_of
from blender_addon.export.write import export_take
from blender_addon.scene.bake import add_take
from blender_addon.scene.hand_edits import played_channels
from solver_backend.io.motions.bvh import read_bvh
from tests.support.moving_fingers import FRAMES, moving_fingers


@pytest.fixture(scope="module")
def hands():
    return read_body(default_body_path(), SMPL_HANDS)


@pytest.fixture
def armature(scene, hands):
    return create_rig("Body", hands, np.zeros(10), scene.collection).armature


def tails(armature):
    bpy.context.view_layer.update()
    return {bone.name: np.array(bone.tail) for bone in armature.pose.bones}


def test_a_body_without_fingers_has_no_such_controls(scene, body):
    plain = create_rig("Plain", body, np.zeros(10), scene.collection).armature
    assert not has_finger_controls(plain) and not set(CONTROLS) & set(plain.data.bones.keys())
    assert "Finger Controls" not in plain.data.collections


def test_a_curl_bends_its_finger_alone_into_the_palm(armature):
    before = tails(armature)
    for side, finger in product(("left", "right"), FINGERS):
        palm = np.array(armature.pose.bones[f"{side}_wrist"].z_axis)
        control = armature.pose.bones[finger_control(side, finger)]
        control.rotation_euler[0] = np.radians(25)
        after = tails(armature)
        control.rotation_euler[0] = 0.0
        moved = {joint: np.linalg.norm(after[joint] - before[joint]) for joint in SMPL_HANDS.joints}
        own = {f"{side}_{finger}{k}" for k in (1, 2, 3)}
        assert {joint for joint, distance in moved.items() if distance > 1e-6} == own, (side, finger)
        assert (after[f"{side}_{finger}3"] - before[f"{side}_{finger}3"]) @ palm > 0.003, (side, finger)


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_fist_closes_every_finger_and_a_fan_opens_it(armature, side):
    before = tails(armature)
    control = armature.pose.bones[fist_control(side)]
    control.rotation_euler[0] = np.radians(90)
    fist = tails(armature)
    for finger in FINGERS[1:]:
        tip, knuckle = f"{side}_{finger}3", np.array(armature.pose.bones[f"{side}_{finger}1"].head)
        assert np.linalg.norm(fist[tip] - knuckle) < 0.6 * np.linalg.norm(before[tip] - knuckle)
    control.rotation_euler = (0.0, 0.0, np.radians(20))
    fan = tails(armature)
    order = [f"{side}_{finger}3" for finger in ("thumb", "index", "middle", "ring", "pinky")]
    gaps = [[np.linalg.norm(at[a] - at[b]) for a, b in pairwise(order)] for at in (before, fan)]
    assert (np.array(gaps[1]) > np.array(gaps[0]) + 0.002).all()


def test_controls_add_to_what_is_keyed_and_are_part_of_the_pose(scene, armature, hands):
    bone = armature.pose.bones["left_index2"]
    bone.rotation_quaternion = (np.cos(0.2), np.sin(0.2), 0.0, 0.0)
    armature.pose.bones[finger_control("left", "index")].rotation_euler[0] = 0.4
    bpy.context.view_layer.update()
    rest = hands.rest_joints(np.zeros(10))
    pose = read_pose(armature, rest[0])
    turn = np.linalg.norm(pose.rotvec[SMPL_HANDS.joints.index("left_index2")])
    assert turn == pytest.approx(0.4 + 0.85 * 0.4, abs=1e-3)
    _, expected = pose_joints(rest, pose.rotvec[None], pose.transl[None])
    found = np.array([armature.pose.bones[joint].head for joint in SMPL_HANDS.joints])
    np.testing.assert_allclose(found, expected[0], atol=1e-4)


def test_a_curl_is_an_edit_and_leaves_in_files(scene, hands, tmp_path):
    armature, _ = add_take(scene, "take", moving_fingers(hands.id, 24.0), hands, None, None, 1)
    times = np.arange(1.0, FRAMES + 1)
    plain = played_channels(scene, armature, times)
    control = armature.pose.bones[finger_control("left", "ring")]
    scene.frame_set(1)
    control.rotation_euler[0] = 0.7
    control.keyframe_insert("rotation_euler", index=0, frame=1)
    edited = played_channels(scene, armature, times)
    ring = SMPL_HANDS.joints.index("left_ring1")
    columns = np.abs(edited - plain).max(axis=0)[3:].reshape(52, 4).max(axis=1)
    assert set(np.flatnonzero(columns > 1e-3)) == {ring, ring + 1, ring + 2}
    joints = np.stack([evaluated_joints(scene, armature, frame) for frame in times])
    clip = read_bvh(export_take(take_of(scene, armature), "bvh", tmp_path / "take.bvh"))
    order = [clip.names.index(joint) for joint in SMPL_HANDS.joints]
    assert np.linalg.norm(clip.positions()[:, order] - joints, axis=-1).max() < 1e-4


def test_another_take_does_not_inherit_a_curl(scene, hands):
    armature, _ = add_take(scene, "first", moving_fingers(hands.id, 24.0), hands, None, None, 1)
    armature.pose.bones[fist_control("right")].rotation_euler[0] = 1.0
    add_take(scene, "second", moving_fingers(hands.id, 24.0), hands, armature, None, 1)
    scene.frame_set(3)
    assert armature.pose.bones[fist_control("right")].rotation_euler[0] == 0.0
