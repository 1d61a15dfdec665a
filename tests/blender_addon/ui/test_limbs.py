"""FK and IK by button, on a solved take: the motion stays, and each is one undo step."""

from __future__ import annotations

import bpy
import numpy as np
import pytest

from blender_addon.animation.action import read_pose
from blender_addon.animation.deviation import evaluated_joints
from blender_addon.body.body_file import body_path_of, read_body
from blender_addon.body.controls.limbs import LIMBS, ROOT
from blender_addon.ui.operators.import_results import take_motion


def _joints(armature: bpy.types.Object) -> np.ndarray:
    return np.stack([evaluated_joints(bpy.context.scene, armature, float(frame)) for frame in range(1, 13, 3)])


def test_the_buttons_keep_the_motion(mocap, solved_take) -> None:
    armature = mocap.review.armature
    before = _joints(armature)
    assert bpy.ops.mocap.switch_limbs(to="IK") == {"FINISHED"}
    assert [armature.pose.bones[ROOT][limb.switch] for limb in LIMBS] == [1.0] * 4
    np.testing.assert_allclose(_joints(armature), before, atol=1e-3)
    assert bpy.ops.mocap.switch_limbs(to="FK", limb="left_leg_ik") == {"FINISHED"}
    assert [armature.pose.bones[ROOT][limb.switch] for limb in LIMBS] == [1.0, 1.0, 0.0, 1.0]
    np.testing.assert_allclose(_joints(armature), before, atol=1e-3)
    assert "UNDO" in bpy.types.MOCAP_OT_switch_limbs.bl_options


def test_another_take_of_the_body_is_not_led_by_the_first_ones_hands(mocap, solved_take, solved) -> None:
    armature = mocap.review.armature
    before = _joints(armature)
    bpy.ops.mocap.switch_limbs(to="IK")
    take_motion(bpy.context, solved.files)
    assert mocap.review.armature == armature and mocap.review.take != solved_take
    np.testing.assert_allclose(_joints(armature), before, atol=1e-4)
    assert [armature.pose.bones[ROOT][limb.switch] for limb in LIMBS] == [0.0] * 4


def test_the_joints_of_a_limb_are_hidden_while_its_end_leads(mocap, solved_take, solved) -> None:
    armature, others = mocap.review.armature, ("left_collar", "left_hand")

    def shown(bone: str) -> bool:
        return any(group.is_visible for group in armature.data.bones[bone].collections)

    leg, arm = ("left_hip", "left_knee", "left_ankle"), ("left_shoulder", "left_elbow", "left_wrist")
    assert all(shown(bone) for bone in (*leg, *arm, *others)) and not shown("left_hand_ik")
    bpy.ops.mocap.switch_limbs(to="IK", limb="left_arm_ik")
    assert not any(shown(bone) for bone in arm) and shown("left_hand_ik") and shown("left_elbow_pole")
    assert all(shown(bone) for bone in (*leg, *others)), "the collar and other limbs stay"
    take_motion(bpy.context, solved.files)
    assert all(shown(bone) for bone in arm) and not shown("left_hand_ik"), "the new take is posed joint by joint"
    bpy.ops.mocap.show_take(name=solved_take.name)
    assert not any(shown(bone) for bone in arm) and shown("left_hand_ik")
    armature.data.collections_all["IK Arm Left"].is_visible = False
    bpy.ops.mocap.show_take(name=solved_take.name)
    assert not shown("left_hand_ik"), "what the user hid stays hidden"
    bpy.ops.mocap.switch_limbs(to="FK")
    assert all(shown(bone) for bone in arm) and not shown("left_hand_ik")


@pytest.mark.parametrize("moved", [False, True])
def test_a_pin_is_what_is_seen_also_with_ik_and_a_moved_root(mocap, solved_take, moved: bool) -> None:
    armature = mocap.review.armature
    bpy.context.scene.frame_set(4)
    rest = read_body(body_path_of(solved_take["provenance"])).rest_joints(np.array(solved_take["betas"]))
    bpy.context.view_layer.update()
    by_joints = read_pose(armature, rest[0])
    bpy.ops.mocap.switch_limbs(to="IK")
    if moved:
        armature.pose.bones[ROOT].location = (0.5, 0.0, 0.0)
    bpy.context.scene.frame_set(4)
    found = read_pose(armature, rest[0])
    np.testing.assert_allclose(found.transl, by_joints.transl + [0.5 * moved, 0, 0], atol=1e-4)
    if not moved:  # hands and feet go with the root as well: the pose is the same
        np.testing.assert_allclose(found.rotvec, by_joints.rotvec, atol=2e-3)
    np.testing.assert_allclose(found.rotvec[1:], by_joints.rotvec[1:], atol=2e-3)
