"""Bones that a person can pose: names, tree, tails, rolls, collections."""

from __future__ import annotations

import bpy
import numpy as np
import pytest

from blender_addon.body.armature import DEFORM_COLLECTION, HELPER_COLLECTION, bone_axes, deform_bone
from blender_addon.body.body_file import BodyFile
from blender_addon.body.controls.limbs import CONTROLS, HELPERS, LIMBS, ROOT
from blender_addon.body.rig import Rig, create_rig
from blender_addon.conventions.skeleton import JOINTS, PARENTS, SMPL
from tests.support.posed_rig import evaluated, pose


def test_bones_are_smpls_tree_and_one_deform_bone_each(rig: Rig) -> None:
    bones = rig.armature.data.bones
    assert sorted(bones.keys()) == sorted([*JOINTS, *map(deform_bone, JOINTS), ROOT, *CONTROLS, *HELPERS])
    parents = [bones[joint].parent.name for joint in JOINTS]
    assert parents.pop(0) == ROOT and [JOINTS.index(parent) for parent in parents] == list(PARENTS[1:])
    assert {bone.name for bone in bones if bone.use_deform} == set(map(deform_bone, JOINTS))
    for joint in JOINTS:
        assert bones[deform_bone(joint)].parent == bones[joint] and not bones[deform_bone(joint)].children
        assert rig.armature.pose.bones[joint].rotation_mode == "QUATERNION"


@pytest.mark.parametrize("sign", [-2.0, 0.0, 2.0])
def test_rest_is_a_t_of_the_shape_it_was_made_for(scene: bpy.types.Scene, body: BodyFile, sign: float) -> None:
    betas = np.full(10, sign)
    rig = create_rig("Body", body, betas, scene.collection)
    rest = body.rest_joints(betas) - body.rest_joints(betas)[0]
    found = np.array([rig.armature.data.bones[joint].head_local for joint in JOINTS])
    assert found[0, :2].tolist() == [0.0, 0.0]
    np.testing.assert_allclose(found - found[0], np.stack([rest[:, 0], -rest[:, 2], rest[:, 1]], -1), atol=1e-6)
    joints, vertices = evaluated(rig)
    assert abs(vertices[:, 2].min()) < 1e-6, "it stands on the origin"
    np.testing.assert_allclose(joints, found, atol=2e-6)
    arm, leg = joints[20] - joints[16], joints[7] - joints[1]
    assert abs(arm[0]) > 0.99 * np.linalg.norm(arm) and abs(leg[2]) > 0.98 * np.linalg.norm(leg)


def test_tails_reach_the_next_joint_or_the_surface(rig: Rig, body: BodyFile) -> None:
    bones = rig.armature.data.bones
    for j, child in SMPL.main_child.items():
        assert (bones[JOINTS[j]].tail_local - bones[JOINTS[child]].head_local).length < 1e-6
    _, vertices = evaluated(rig)
    assert bones["head"].tail_local.z == pytest.approx(vertices[:, 2].max(), abs=2e-3)
    assert bones["left_hand"].tail_local.x == pytest.approx(vertices[:, 0].max(), abs=2e-2)
    assert bones["left_foot"].tail_local.y == pytest.approx(vertices[:, 1].min(), abs=2e-2)
    assert min(bone.length for bone in bones) > 0.02


def test_local_axes_mirror(rig: Rig) -> None:
    axes = dict(zip(JOINTS, bone_axes(rig.armature), strict=True))
    for joint in JOINTS:
        if joint.startswith("left"):
            mirrored = np.diag([-1.0, 1.0, 1.0]) @ axes[joint] @ np.diag([-1.0, 1.0, 1.0])
            np.testing.assert_allclose(axes[joint.replace("left", "right")], mirrored, atol=1e-5)


_FORWARD, _BACKWARD, _UP, _DOWN = (0, -1, 0), (0, 1, 0), (0, 0, 1), (0, 0, -1)


def test_a_positive_turn_about_local_x_bends_the_natural_way(rig: Rig) -> None:
    rest, _ = evaluated(rig)
    for joint, end, direction in (
        ("elbow", "wrist", _FORWARD), ("shoulder", "elbow", _FORWARD), ("wrist", "hand", _DOWN),
        ("hip", "knee", _FORWARD), ("knee", "ankle", _BACKWARD), ("ankle", "foot", _UP),
    ):  # fmt: skip
        bones = [rig.armature.pose.bones[f"{side}_{joint}"] for side in ("left", "right")]
        for bone in bones:
            bone.rotation_quaternion = (np.cos(0.3), np.sin(0.3), 0, 0)
        moved = evaluated(rig)[0] - rest
        for bone in bones:
            bone.rotation_quaternion = (1, 0, 0, 0)
        for side in ("left", "right"):
            step = moved[JOINTS.index(f"{side}_{end}")]
            assert step @ direction > 0.9 * np.linalg.norm(step) > 0.01, (side, joint)


def test_trunk_and_head_nod_forward_about_local_x(rig: Rig) -> None:
    rest, _ = evaluated(rig)
    for joint in ("spine1", "neck"):
        rig.armature.pose.bones[joint].rotation_quaternion = (np.cos(0.2), np.sin(0.2), 0, 0)
    assert (evaluated(rig)[0] - rest)[JOINTS.index("head"), 1] < -0.1


def test_every_bone_has_its_collection_and_colour(rig: Rig) -> None:
    collections = rig.armature.data.collections
    held = {collection.name: {bone.name for bone in collection.bones} for collection in collections}
    assert held.pop(DEFORM_COLLECTION) == {deform_bone(joint) for joint in JOINTS}
    assert held.pop(HELPER_COLLECTION) == set(HELPERS)
    assert sorted(name for names in held.values() for name in names) == sorted([ROOT, *JOINTS, *CONTROLS])
    limbs = {f"{part} {side}" for part in ("Arm", "Leg") for side in ("Left", "Right")}
    shown = {"Root", "Torso", "Head", *limbs, *(f"FK {limb}" for limb in limbs)}
    assert {c.name for c in collections if c.is_visible} == shown
    assert set(held) == shown | {limb.collection for limb in LIMBS} | {"IK Twist"}
    colours = {joint: tuple(rig.armature.data.bones[joint].color.custom.normal) for joint in JOINTS}
    assert {rig.armature.data.bones[joint].color.palette for joint in JOINTS} == {"CUSTOM"}
    assert colours["left_knee"] == colours["left_hand"] != colours["right_knee"] == colours["right_hand"]
    assert len(set(colours.values())) == 3 and min(map(max, colours.values())) > 0.9


def test_joints_cannot_be_pulled_apart_by_hand(rig: Rig) -> None:
    locks = {joint: tuple(rig.armature.pose.bones[joint].lock_location) for joint in JOINTS}
    assert locks.pop("pelvis") == (False, False, False)
    assert set(locks.values()) == {(True, True, True)}


def test_pasted_flipped_pose_is_the_mirror_image(rig: Rig) -> None:
    """Blender mirrors a pose by names and local axes: q = (w, x, y, z) becomes (w, x, -y, -z) on the other side."""
    rng = np.random.default_rng(3)
    pose(rig, 0.3 * rng.normal(size=(24, 3)) * (np.arange(24) > 0)[:, None])
    joints, _ = evaluated(rig)
    bones = rig.armature.pose.bones
    turns = {joint: np.array(bones[joint].rotation_quaternion) * [1, 1, -1, -1] for joint in JOINTS}
    for joint, turn in turns.items():
        if joint != "pelvis":
            bones[_other(joint)].rotation_quaternion = turn
    mirrored, _ = evaluated(rig)
    order = [JOINTS.index(_other(joint)) for joint in JOINTS]
    np.testing.assert_allclose(mirrored[order] * [-1, 1, 1], joints, atol=1e-4)


def _other(joint: str) -> str:
    side, _, part = joint.partition("_")
    return {"left": f"right_{part}", "right": f"left_{part}"}.get(side, joint)
