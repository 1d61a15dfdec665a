"""Retarget by its buttons: map, table, map pose, motion; what is missing is said, and nothing is half-done."""

from __future__ import annotations

import bpy
import numpy as np
import pytest

from blender_addon.animation.curves import current_action
from blender_addon.retarget import recognition
from blender_addon.ui.operators.retarget import chosen_settings
from tests.support.mixamo_rig import PREFIX, mixamo_rig
from tests.support.narrow_layout import draw_panel


@pytest.fixture
def rig(mocap: bpy.types.PropertyGroup, solved_take: bpy.types.Action) -> bpy.types.Object:
    rig = mixamo_rig("Character")
    mocap.retarget.target = rig
    return rig


def test_a_motion_is_laid_on_a_character_by_the_buttons(mocap, rig, solved_take):
    before = current_action(mocap.review.armature)
    assert bpy.ops.mocap.map_rig() == {"FINISHED"}
    table = {row.name: row.bone for row in mocap.retarget.table}
    assert table["left_foot"] == f"{PREFIX}LeftFoot" and mocap.retarget.label == "Mixamo"
    assert bpy.ops.mocap.retarget() == {"FINISHED"}
    played = current_action(rig)
    assert played is not None and played != solved_take and current_action(mocap.review.armature) == before
    scene = bpy.context.scene
    heads = []
    for frame in (scene.frame_start, scene.frame_start + 20):
        scene.frame_set(frame)
        heads.append(np.array(rig.pose.bones[f"{PREFIX}LeftHand"].head))
    assert np.linalg.norm(heads[1] - heads[0]) > 0.005, "the rig moves"


def test_the_target_is_mapped_when_it_is_chosen(mocap, rig, solved_take):
    table = {row.name: row.bone for row in mocap.retarget.table}
    assert (
        table["left_foot"] == f"{PREFIX}LeftFoot" and mocap.retarget.label == "Mixamo" and not mocap.retarget.warnings
    )
    assert bpy.ops.mocap.retarget() == {"FINISHED"}, "nothing else is to be pressed"
    box = bpy.data.objects.new("Box", bpy.data.armatures.new("Box"))
    bpy.context.scene.collection.objects.link(box)
    mocap.retarget.target = box
    drawn = draw_panel(bpy.types.VIEW3D_PT_mocap_retarget, 283).drawn
    assert "Choose the bones" in " ".join(drawn) and "Retarget" not in drawn
    mocap.retarget.target = None
    assert not len(mocap.retarget.table) and not mocap.retarget.warnings


def test_the_scale_is_shown_only_where_the_user_sets_it(mocap, rig, solved_take):
    settings = mocap.retarget

    def drawn() -> list[str]:
        return draw_panel(bpy.types.VIEW3D_PT_mocap_retarget, 283).drawn

    assert settings.automatic_scale and settings.scale == 0
    assert "Automatic Scale" in drawn() and "Scale" not in drawn()
    settings.automatic_scale = False
    assert "Scale" in drawn() and settings.scale == 1, "the actor's own travel is where a user begins"
    settings.scale = 2.5
    settings.automatic_scale = False
    assert settings.scale == 2.5 and not settings.automatic_scale, "a scale that is set is kept"
    assert chosen_settings(bpy.context.scene).transfer.scale == 2.5
    settings.automatic_scale = True
    assert settings.scale == 0 and "Scale" not in drawn()
    assert chosen_settings(bpy.context.scene).transfer.scale == 0


def test_left_and_right_stand_beside_each_other(mocap, rig, solved_take):
    drawn = draw_panel(bpy.types.VIEW3D_PT_mocap_bone_table, 283).drawn
    assert "foot" in drawn and "left foot" not in drawn and "pelvis" in drawn
    at = drawn.index("foot")
    assert drawn[at + 1 : at + 3] == ["", ""], "two fields behind one word"


def test_a_retargeted_motion_follows_the_frame_rate(mocap, rig, solved_take):
    assert bpy.ops.mocap.map_rig() == {"FINISHED"} and bpy.ops.mocap.retarget() == {"FINISHED"}
    played, scene = current_action(rig), bpy.context.scene
    assert played.frame_range[1] == pytest.approx(solved_take.frame_range[1])
    scene.render.fps = 24
    assert bpy.ops.mocap.follow_rate() == {"FINISHED"}
    assert solved_take.frame_range[1] < 20 and played.frame_range[1] == pytest.approx(solved_take.frame_range[1])


def test_the_pose_that_the_rig_stands_in_becomes_its_map_pose(mocap, rig):
    bpy.ops.mocap.map_rig()
    rig.pose.bones[f"{PREFIX}LeftArm"].rotation_mode = "XYZ"
    rig.pose.bones[f"{PREFIX}LeftArm"].rotation_euler = (0.0, 0.0, 0.5)
    bpy.context.view_layer.update()
    text = mocap.retarget.map_text
    assert bpy.ops.mocap.set_map_pose() == {"FINISHED"} and mocap.retarget.map_text != text
    assert bpy.ops.mocap.retarget() == {"FINISHED"}


def test_a_map_is_kept_as_a_preset_that_finds_the_rig_again(mocap, rig, tmp_path, monkeypatch):
    monkeypatch.setattr(recognition, "user_presets_folder", lambda *, make=False: tmp_path)
    for row in mocap.retarget.table:
        if row.name == "left_toe":
            row.bone = ""
    assert bpy.ops.mocap.set_map_pose() == {"FINISHED"}
    assert bpy.ops.mocap.save_preset(name="Held/in ä") == {"FINISHED"}
    assert mocap.retarget.label == "Held/in ä" and [path.name for path in tmp_path.iterdir()] == ["Held_in ä.json"]
    kept = mocap.retarget.map_text
    mocap.retarget.target = None
    mocap.retarget.target = rig
    assert mocap.retarget.label == "Held/in ä" and mocap.retarget.map_text == kept, "it comes before our own preset"
    assert {row.name: row.bone for row in mocap.retarget.table}["left_toe"] == ""
    assert bpy.ops.mocap.save_preset(name="Held/in ä") == {"FINISHED"}, "it is replaced"
    assert "Save Preset" in draw_panel(bpy.types.VIEW3D_PT_mocap_bone_table, 283).drawn
    rig.data.bones[f"{PREFIX}LeftHand"].name = "hand of another rig"
    mocap.retarget.target = None
    mocap.retarget.target = rig
    assert mocap.retarget.label == "Mixamo", "a rig without one of its bones is another"


def test_presets_without_a_folder_are_named(mocap, rig, monkeypatch):
    monkeypatch.setattr(recognition, "user_presets_folder", lambda *, make=False: None)
    with pytest.raises(RuntimeError, match="no folder for user presets"):
        bpy.ops.mocap.save_preset()


def test_what_is_missing_is_said_and_nothing_is_made(mocap, rig):
    actions = len(bpy.data.actions)
    mocap.retarget.map_text = ""
    with pytest.raises(RuntimeError, match="has not been mapped"):
        bpy.ops.mocap.retarget()
    bpy.ops.mocap.map_rig()
    for row in mocap.retarget.table:
        if "leg" in row.name or "thigh" in row.name or "shin" in row.name or row.name == "pelvis":
            row.bone = ""
    with pytest.raises(RuntimeError):
        bpy.ops.mocap.retarget()
    mocap.retarget.target = None
    with pytest.raises(RuntimeError, match="There is no target"):
        bpy.ops.mocap.map_rig()
    assert len(bpy.data.actions) == actions


def test_another_rig_is_the_actor_without_a_solved_body(mocap, scene):
    source, target = mixamo_rig("Source"), mixamo_rig("Target", "tall")
    assert not bpy.ops.mocap.map_rig.poll(), "there is no actor yet"
    for frame, angle in ((1, 0.0), (20, 0.6)):
        bone = source.pose.bones[f"{PREFIX}LeftArm"]
        bone.rotation_mode, bone.rotation_euler = "XYZ", (0.0, 0.0, angle)
        bone.keyframe_insert("rotation_euler", frame=frame)
    mocap.retarget.actor, mocap.retarget.target = source, target
    assert bpy.ops.mocap.map_rig() == {"FINISHED"} and bpy.ops.mocap.retarget() == {"FINISHED"}
    played = current_action(target)
    assert played is not None and played.frame_range[1] == pytest.approx(20.0)
    mocap.retarget.target = source
    bpy.ops.mocap.map_rig.poll()
    with pytest.raises(RuntimeError, match="same armature"):
        bpy.ops.mocap.map_rig()
