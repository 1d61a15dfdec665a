"""Curves of the action: their keys, and what lies between."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import bpy
import numpy as np

from blender_addon.animation.curves import action_curves
from blender_addon.animation.deviation import evaluated_joints
from blender_addon.conventions.skeleton import JOINTS
from blender_addon.scene.bake import BakedTake, bake_take


def test_joints_between_frames_lie_between(scene: bpy.types.Scene, take: BakedTake, files: Any) -> None:
    """Linear curves: half way in time the pelvis is half way in space."""
    found = evaluated_joints(scene, take.armature, 11.5)[0]
    np.testing.assert_allclose(found, files.motion.joints[10:12, 0].mean(axis=0), atol=1e-5)


def test_curves_are_linear_with_key_types(take: BakedTake, files: Any) -> None:
    switches = [curve for curve in action_curves(take.action) if curve.data_path.startswith('pose.bones["root"]')]
    assert [[p.co.y for p in curve.keyframe_points] for curve in switches] == [[0.0]] * 4, "all limbs are FK"
    curves = [curve for curve in action_curves(take.action) if curve not in switches]
    assert len(curves) == 3 + 4 * 24
    hands = [curve for curve in curves if curve.group.name in ("left_hand", "right_hand")]
    assert [len(curve.keyframe_points) for curve in hands] == [1] * 8, "what never moves has one key"
    for curve in curves:
        points = curve.keyframe_points
        if curve in hands:
            continue
        assert len(points) == 60
        assert {p.interpolation for p in points} == {"LINEAR"}
        assert [p.type for p in points] == ["KEYFRAME" if key else "GENERATED" for key in files.motion.keyframes]
        assert [p.co.x for p in points] == list(range(1, 61))
    assert {curve.group.name for curve in curves} == set(JOINTS)


def test_without_keyframes_every_key_is_a_keyframe(scene: bpy.types.Scene, files: Any) -> None:
    take = bake_take(scene, replace(files.motion, keyframes=None), files.body)
    assert {p.type for curve in action_curves(take.action) for p in curve.keyframe_points} == {"KEYFRAME"}


def test_quaternion_curves_never_jump(take: BakedTake) -> None:
    """The right elbow turns by 360 degrees: raw quaternions would flip sign on the way."""
    for joint in JOINTS:
        path = f'pose.bones["{joint}"].rotation_quaternion'
        columns = [c for c in action_curves(take.action) if c.data_path == path]
        quat = np.array([[p.co.y for p in c.keyframe_points] for c in sorted(columns, key=lambda c: c.array_index)]).T
        np.testing.assert_allclose(np.linalg.norm(quat, axis=1), 1, atol=1e-6)
        assert ((quat[1:] * quat[:-1]).sum(axis=1) > 0.9).all()
    elbow = [c for c in action_curves(take.action) if "right_elbow" in c.data_path and c.array_index == 0]
    assert elbow[0].keyframe_points[59].co.y < -0.99


def test_action_is_one_bound_and_kept(take: BakedTake) -> None:
    animation = take.armature.animation_data
    assert animation.action is take.action and take.action.use_fake_user
    if hasattr(take.action, "slots"):
        assert len(take.action.slots) == 1 and animation.action_slot == take.action.slots[0]
    assert take.action["provenance"] == '{"version": "test"}' and take.action["fps"] == 30.0
