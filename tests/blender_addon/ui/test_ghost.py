"""The ghost of another take: the skin that the take would show, and nothing of it in the file."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import bpy
import numpy as np
import pytest
from mathutils import Quaternion

from blender_addon.animation.curves import action_curves, create_action
from blender_addon.animation.deviation import evaluated_vertices
from blender_addon.body.controls.limbs import ROOT
from blender_addon.body.shape import body_mesh
from blender_addon.review.ghost import shaded
from blender_addon.ui.operators.import_results import take_motion
from blender_addon.ui.viewport import ghost_of, ghosts
from tests.support.narrow_layout import NarrowContext
from tests.support.panel_layout import Layout

FRAMES = (4.0, 12.0, 25.0)
LISTS = ("objects", "actions", "scenes", "meshes", "armatures", "shape_keys", "collections", "node_groups")
ATOL_M = 1e-4


def contents(armature: bpy.types.Object) -> dict[str, Any]:
    """Return what the file holds, who uses it, and what a body plays."""
    found: dict[str, Any] = {
        name: sorted((item.name, item.users) for item in getattr(bpy.data, name)) for name in LISTS
    }
    animation = armature.animation_data
    tracks = [(track.name, track.mute, [strip.name for strip in track.strips]) for track in animation.nla_tracks]
    keys = [len(curve.keyframe_points) for action in bpy.data.actions for curve in action_curves(action)]
    place = [*armature.location, *np.ravel(armature.pose.bones[ROOT].matrix_basis)]
    drivers = [curve.data_path for curve in animation.drivers]
    return {**found, "plays": animation.action, "tracks": tracks, "keys": keys, "place": place, "drivers": drivers}


def skins(mesh: bpy.types.Object) -> list[np.ndarray]:
    return [evaluated_vertices(bpy.context.scene, mesh, frame) for frame in FRAMES]


@pytest.mark.parametrize("edit", ["fk", "ik", "root"])
def test_a_ghost_is_the_skin_of_the_take_with_its_edits(mocap, solved_take, solved, edit: str) -> None:
    scene, armature = bpy.context.scene, mocap.review.armature
    mesh = body_mesh(armature)
    assert mesh is not None
    armature.location.y = 0.4
    if edit == "ik":
        assert bpy.ops.mocap.switch_limbs(to="IK", limb="left_arm_ik") == {"FINISHED"}
        scene.frame_set(12)
        armature.pose.bones["left_hand_ik"].location.z += 0.1
        armature.pose.bones["left_hand_ik"].keyframe_insert("location")
    elif edit == "fk":
        scene.frame_set(12)
        bone = armature.pose.bones["left_elbow"]
        bone.rotation_quaternion = bone.rotation_quaternion @ Quaternion((0.0, 0.0, 1.0), 0.9)
        bone.keyframe_insert("rotation_quaternion")
    else:
        armature.pose.bones[ROOT].location = (0.3, 0.0, 0.1)
        armature.pose.bones[ROOT].rotation_quaternion = Quaternion((0.0, 0.0, 1.0), 0.5)
    seen = skins(mesh)
    second = take_motion(bpy.context, solved.files)
    armature.location.y = 0.0
    before, unlike = contents(armature), skins(mesh)
    assert bpy.ops.mocap.ghost_take(name=solved_take.name) == {"FINISHED"}
    assert contents(armature) == before and mocap.review.take == second
    ghost = ghost_of(mocap.review)
    assert ghost is not None
    for frame, expected, other in zip(FRAMES, seen, unlike, strict=True):
        np.testing.assert_allclose(ghost.skin(frame), expected, atol=ATOL_M)
        assert np.abs(expected - other).max() > 0.1, "the shown take is elsewhere"
    colours = shaded(ghost.skin(12.0), ghost.body.faces, np.array([0.0, -1.0, 0.0]))
    assert colours.shape == (len(seen[0]), 4) and 0.0 < colours[:, 3].min() < 0.2 < 0.6 < colours[:, 3].max() < 1.0
    assert bpy.ops.mocap.ghost_take(name=solved_take.name) == {"FINISHED"}
    assert not ghosts and contents(armature) == before


def test_a_ghost_disappears_with_its_take_and_when_that_is_shown(mocap, solved_take, solved) -> None:
    first, review = solved_take.name, mocap.review
    second = take_motion(bpy.context, solved.files).name
    assert bpy.ops.mocap.ghost_take(name=first) == {"FINISHED"} and ghost_of(review) is not None
    assert bpy.ops.mocap.show_take(name=first) == {"FINISHED"} and ghost_of(review) is None
    assert bpy.ops.mocap.show_take(name=second) == {"FINISHED"} and ghost_of(review) is not None
    assert bpy.ops.mocap.delete_take(name=first) == {"FINISHED"} and ghost_of(review) is None


def test_each_other_take_has_a_button_for_its_ghost(mocap, solved_take, solved) -> None:
    def buttons() -> int:
        layout = Layout()
        bpy.types.VIEW3D_PT_mocap_review.draw(SimpleNamespace(layout=layout), NarrowContext(400))
        return layout.drawn.count("operator:")

    alone = buttons()
    take_motion(bpy.context, solved.files)
    assert buttons() == alone + 2, "one deletes the other take, and one shows its ghost"


def test_a_ghost_below_layers_leaves_the_layers_alone(mocap, solved_take, solved) -> None:
    armature = mocap.review.armature
    second = take_motion(bpy.context, solved.files)
    assert bpy.ops.mocap.edit_on_layer() == {"FINISHED"}
    before = contents(armature)
    assert bpy.ops.mocap.ghost_take(name=solved_take.name) == {"FINISHED"}
    assert contents(armature) == before and mocap.review.take == second
    create_action("Mine", armature)
    assert ghost_of(mocap.review) is not None
