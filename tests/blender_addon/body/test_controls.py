"""Controls: each posed bone can be grabbed around its skin, and none is rendered."""

from __future__ import annotations

import bpy
import numpy as np

from blender_addon.body.armature import bone_axes, deform_bone
from blender_addon.body.body_file import BodyFile
from blender_addon.body.controls.shapes import shape_lines
from blender_addon.body.rig import Rig
from blender_addon.conventions.skeleton import JOINTS
from tests.support.posed_rig import evaluated


def test_every_posed_bone_has_a_control_and_no_other(rig: Rig) -> None:
    bones = rig.armature.pose.bones
    assert all(bones[joint].custom_shape is not None for joint in JOINTS)
    assert all(bones[deform_bone(joint)].custom_shape is None for joint in JOINTS)
    assert all(not bone.use_custom_shape_bone_size for bone in bones if bone.custom_shape)


def test_rings_surround_the_limb(rig: Rig, body: BodyFile) -> None:
    _, vertices = evaluated(rig)
    for joint in ("left_elbow", "right_knee", "neck", "left_hip", "right_shoulder"):
        bone, j = rig.armature.pose.bones[joint], JOINTS.index(joint)
        local = (vertices[body.weights.argmax(axis=1) == j] - np.array(bone.head)) @ bone_axes(rig.armature)[j]
        local = (local - np.array(bone.custom_shape_translation)) / np.array(bone.custom_shape_scale_xyz)
        section = local[np.abs(local[:, 1]) < 0.5]
        assert len(section) > 10
        assert 0.6 < np.linalg.norm(section[:, [0, 2]], axis=1).max() < 1.1


def test_controls_mirror(rig: Rig) -> None:
    bones = rig.armature.pose.bones
    for joint in JOINTS:
        if joint.startswith("left"):
            left, right = bones[joint], bones[joint.replace("left", "right")]
            assert left.custom_shape == right.custom_shape
            np.testing.assert_allclose(left.custom_shape_scale_xyz, right.custom_shape_scale_xyz, atol=1e-4)
            flipped = np.array(left.custom_shape_translation) * [-1, 1, 1]
            np.testing.assert_allclose(flipped, right.custom_shape_translation, atol=1e-4)


def test_controls_are_seen_only_as_controls(scene: bpy.types.Scene, rig: Rig) -> None:
    shapes = {bone.custom_shape for bone in rig.armature.pose.bones if bone.custom_shape}
    bpy.context.view_layer.update()
    for shape in shapes:
        assert not shape.visible_get() and all(c.hide_render for c in shape.users_collection)
        assert not shape.data.polygons


def test_lines_of_controls_are_where_blender_draws_them_and_have_the_colours_of_their_sides(rig: Rig) -> None:
    bones = rig.armature.pose.bones
    bones["left_elbow"].rotation_quaternion = (0.8, 0.6, 0.0, 0.0)
    rig.armature.location = (1.0, 0.0, 0.0)
    bpy.context.view_layer.update()
    lines = shape_lines(rig.armature)
    left, right, middle = (
        tuple(bones[name].bone.color.custom.normal) for name in ("left_elbow", "right_elbow", "head")
    )
    assert lines.keys() == {left, right, middle} and all(len(ends) % 2 == 0 for ends in lines.values())
    assert lines[left][:, 0].min() > 1.0 - 0.05 and lines[right][:, 0].max() < 1.0 + 0.05
    hand = np.array(rig.armature.matrix_world @ bones["left_wrist"].head)
    assert np.linalg.norm(lines[left] - hand, axis=1).min() < 0.1, "rings follow the pose"
    ik = bones["left_hand_ik"]
    assert ik.custom_shape is not None, "which its collection hides"
    count = len(lines[left])
    rig.armature.data.collections_all["IK Arm Left"].is_visible = True
    assert len(shape_lines(rig.armature)[left]) > count
    rig.armature.data.collections_all["Arm Left"].is_visible = False
    bones["left_elbow"].color.palette = "CUSTOM"
    bones["left_elbow"].color.custom.normal = (0.0, 1.0, 0.0)
    assert (0.0, 1.0, 0.0) in shape_lines(rig.armature), "confidence colours the bones of a pose"
