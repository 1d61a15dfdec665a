"""The user's own actions: kept when a take replaces them, and played on top of takes as layers."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np
import pytest
from mathutils import Quaternion

from blender_addon.animation.deviation import evaluated_joints
from blender_addon.animation.layers import add_layer, has_layers
from blender_addon.body.controls.limbs import ROOT
from blender_addon.ui.operators.import_results import take_motion


def resolve(review: bpy.types.PropertyGroup, first: int, last: int) -> None:
    """Solve a range again, fast."""
    bpy.context.scene.mocap.solve.preset = "FAST"
    review.first, review.last = first, last
    assert bpy.ops.mocap.resolve_range() == {"FINISHED"}


FRAMES = (4.0, 12.0, 25.0)


def joints_at(armature: bpy.types.Object) -> np.ndarray:
    return np.stack([evaluated_joints(bpy.context.scene, armature, frame) for frame in FRAMES])


def own_action(armature: bpy.types.Object) -> bpy.types.Action:
    """Replace what a body plays by an action of the user's, as Blender's action editor does."""
    armature.animation_data.action = None
    armature.pose.bones["head"].keyframe_insert("rotation_quaternion", frame=1)
    action = armature.animation_data.action
    assert action is not None
    action.name = "Mine"
    return action


@pytest.mark.parametrize("by", ["click", "import"])
def test_an_action_of_the_users_is_kept_when_a_take_replaces_it(mocap, solved_take, solved, by, capfd) -> None:
    armature = mocap.review.armature
    mine = own_action(armature)
    assert mine.use_fake_user is False
    told: list[str] = []
    if by == "click":
        capfd.readouterr()
        assert bpy.ops.mocap.show_take(name=solved_take.name) == {"FINISHED"}
        told = [line.removeprefix("Info: ") for line in capfd.readouterr().out.splitlines() if "Mine" in line]
    else:
        take_motion(bpy.context, solved.files, tell=told.append)
    assert told == ["Your action 'Mine' is muted on the NLA track 'Mine'"]
    animation = armature.animation_data
    assert animation.action not in (None, mine)
    assert mine.use_fake_user and mine.users >= 2
    [track] = [track for track in animation.nla_tracks if track.name == "Mine"]
    assert track.mute and track.strips[0].action == mine


def nod(armature: bpy.types.Object, take: bpy.types.Action) -> bpy.types.Action:
    layer = add_layer(armature, take)
    head = armature.pose.bones["head"]
    head.rotation_quaternion = (np.cos(0.3), np.sin(0.3), 0.0, 0.0)
    head.keyframe_insert("rotation_quaternion", frame=1)
    pelvis = armature.pose.bones["pelvis"]
    pelvis.location = (0.2, 0.0, 0.0)
    pelvis.keyframe_insert("location", frame=1)
    return layer


def test_a_take_is_found_below_a_layer_and_exchanged_there(mocap, solved_take, solved) -> None:
    armature = mocap.review.armature
    plain = joints_at(armature)
    layer = nod(armature, solved_take)
    seen = joints_at(armature)
    assert np.abs(seen - plain).max() > 0.15, "the layer plays on top"
    assert mocap.review.take == solved_take and has_layers(armature)
    assert bpy.ops.mocap.show_take(name=solved_take.name) == {"FINISHED"}
    np.testing.assert_allclose(joints_at(armature), seen, atol=1e-5)
    take_motion(bpy.context, solved.files)
    animation = armature.animation_data
    assert mocap.review.take not in (layer, solved_take) and animation.action == layer
    assert animation.action_blend_type == "COMBINE"
    np.testing.assert_allclose(joints_at(armature), seen, atol=1e-4)
    assert bpy.ops.mocap.show_take(name=solved_take.name) == {"FINISHED"} and mocap.review.take == solved_take


@pytest.mark.parametrize("work", ["range", "thin"])
def test_work_on_a_take_leaves_the_layers_on_top(mocap, solved_take, work: str) -> None:
    armature: Any = mocap.review.armature
    layer = nod(armature, solved_take)
    seen = joints_at(armature)
    if work == "range":
        resolve(mocap.review, 8, 16)
        assert not mocap.review.pins, "a layer is no hand edit of the take"
    else:
        assert bpy.ops.mocap.thin_take(by="TOLERANCE", tolerance_mm=5.0) == {"FINISHED"}
    animation = armature.animation_data
    assert animation.action == layer and mocap.review.take != solved_take
    found = joints_at(armature)
    np.testing.assert_allclose(found[[0, 2]], seen[[0, 2]], atol=1e-5 if work == "range" else 0.006)
    assert np.abs(found[1] - seen[1]).max() < 0.05, "0.2 m if the layer counted twice"


@pytest.mark.slow
def test_solving_tells_what_it_puts_aside(mocap, solved_take, capfd) -> None:
    own_action(mocap.review.armature)
    mocap.solve.preset = "FAST"
    capfd.readouterr()
    assert bpy.ops.mocap.solve() == {"FINISHED"}
    assert "Info: Your action 'Mine' is muted on the NLA track 'Mine'" in capfd.readouterr().out


def test_a_take_on_the_nla_is_muted_while_another_one_plays(mocap, solved_take, solved) -> None:
    armature = mocap.review.armature
    armature.pose.bones[ROOT].location.x = 0.4
    armature.pose.bones[ROOT].keyframe_insert("location", frame=1)
    plain = joints_at(armature)
    assert bpy.ops.mocap.push_down() == {"FINISHED"}
    told: list[str] = []
    take_motion(bpy.context, solved.files, tell=told.append)
    assert told == ["The take 'Take 01' is muted on the NLA track 'Take 01'"]
    np.testing.assert_allclose(joints_at(armature)[..., 0], plain[..., 0] - 0.4, atol=1e-5)


def test_edits_on_a_layer_are_combined_with_the_take_and_undone(mocap, solved_take) -> None:
    bpy.context.preferences.edit.use_global_undo = True
    bpy.ops.ed.undo_push(message="take")
    armature, name = mocap.review.armature, solved_take.name
    plain = seen = joints_at(armature)
    for count in (1, 2):
        assert bpy.ops.mocap.edit_on_layer.poll()
        assert bpy.ops.mocap.edit_on_layer() == {"FINISHED"}
        animation = armature.animation_data
        assert mocap.review.take == solved_take and animation.action.name.startswith(f"{name} layer")
        np.testing.assert_allclose(joints_at(armature), seen, atol=1e-5)
        chest = armature.pose.bones["spine3"]
        chest.rotation_quaternion = chest.rotation_quaternion @ Quaternion((np.cos(0.2), np.sin(0.2), 0.0, 0.0))
        chest.keyframe_insert("rotation_quaternion", frame=1)
        seen = joints_at(armature)
        assert np.abs(seen - plain).max() > 0.03 * count
        assert not bpy.ops.mocap.push_down.poll(), "the take is on the NLA, and the layer is no take"
    bpy.ops.ed.undo_push(message="layers")
    bpy.ops.ed.undo()
    armature = bpy.context.scene.mocap.review.armature
    assert armature.animation_data.action.name == name and not len(armature.animation_data.nla_tracks)
    np.testing.assert_allclose(joints_at(armature), plain, atol=1e-5)


def place(armature: bpy.types.Object, x: float) -> None:
    armature.pose.bones[ROOT].location.x = x
    armature.location.y = 0.5 * x


def test_each_take_keeps_where_it_was_placed(mocap, solved_take, solved) -> None:
    armature = mocap.review.armature
    place(armature, 0.3)
    first = joints_at(armature)
    take_motion(bpy.context, solved.files)
    second = mocap.review.take
    assert armature.pose.bones[ROOT].location.length == 0.0, "a new take stands as it was solved"
    place(armature, -0.2)
    other = joints_at(armature)
    for take, seen in ((solved_take, first), (second, other), (solved_take, first)):
        assert bpy.ops.mocap.show_take(name=take.name) == {"FINISHED"}
        np.testing.assert_allclose(joints_at(armature), seen, atol=1e-5)
    resolve(mocap.review, 8, 16)
    np.testing.assert_allclose(joints_at(armature)[[0, 2]], first[[0, 2]], atol=1e-5, err_msg="a range stays in place")
    assert bpy.ops.mocap.thin_take(by="TOLERANCE", tolerance_mm=5.0) == {"FINISHED"}
    np.testing.assert_allclose(joints_at(armature)[[0, 2]], first[[0, 2]], atol=6e-3)


def test_an_own_action_that_moves_the_body_leaves_the_place_of_the_take(mocap, solved_take) -> None:
    armature = mocap.review.armature
    armature.location = (0.0, 1.0, 0.0)
    assert bpy.ops.mocap.show_take(name=solved_take.name) == {"FINISHED"}  # remembers the place
    mine = own_action(armature)
    armature.location = (5.0, 5.0, 5.0)
    armature.keyframe_insert("location", frame=1)
    armature.rotation_euler = (0.0, 0.0, 0.5)  # not keyed
    assert armature.animation_data.action == mine
    assert bpy.ops.mocap.show_take(name=solved_take.name) == {"FINISHED"}
    assert list(armature.location) == [0.0, 1.0, 0.0] and armature.rotation_euler[2] == 0.5
