"""Undo after each step of the path: import, solve, limbs, retarget, export; everything is found again."""

from __future__ import annotations

from pathlib import Path

import bpy
import pytest

from blender_addon.animation.curves import current_action
from blender_addon.body.rig import Rig
from blender_addon.conventions.naming import MANNEQUIN, SEGMENTS_LOOK, SUIT_LOOK
from blender_addon.ui.operators.import_results import take_capture, take_motion
from tests.support.looks import look_of
from tests.support.mixamo_rig import mixamo_rig
from tests.support.narrow_layout import draw_panel
from tests.support.shown_panels import panels_of_all_stages


def step(message: str) -> None:
    bpy.ops.ed.undo_push(message=message)


def state() -> tuple[int, bool, bool, bool, bool]:
    """Return captures, and whether body, take, limbs in IK and a retargeted motion are there; draw every panel."""
    for cls in panels_of_all_stages():
        draw_panel(cls, 300)
    mocap, body = bpy.context.scene.mocap, bpy.context.scene.mocap.review.armature
    rig = bpy.data.objects.get("Character")
    return (
        len(mocap.captures),
        body is not None,
        mocap.review.take is not None,
        body is not None and body.pose.bones["root"]["left_leg_ik"] > 0.5,
        rig is not None and current_action(rig) is not None,
    )


@pytest.mark.usefixtures("mocap")
def test_each_step_is_undone_and_redone(solved, tmp_path: Path) -> None:
    bpy.context.preferences.edit.use_global_undo = True
    mixamo_rig("Character")
    step("empty")
    states = [state()]
    take_capture(bpy.context.scene, solved.read)
    step("import")
    states.append(state())
    take_motion(bpy.context, solved.files)
    step("solve")
    states.append(state())
    assert bpy.ops.mocap.switch_limbs(to="IK") == {"FINISHED"}
    step("limbs")
    states.append(state())
    bpy.context.scene.mocap.retarget.target = bpy.data.objects["Character"]
    assert bpy.ops.mocap.retarget() == {"FINISHED"}
    step("retarget")
    states.append(state())
    bpy.context.view_layer.objects.active = bpy.context.scene.mocap.review.armature
    assert bpy.ops.mocap.export_take(filepath=str(tmp_path / "take.bvh"), format="bvh") == {"FINISHED"}
    step("export")
    states.append(state())
    assert len(set(states[:-1])) == 5 and states[-1] == states[-2], "export changes nothing"
    for wanted in states[-2::-1]:
        bpy.ops.ed.undo()
        assert state() == wanted
    for wanted in states[1:]:
        bpy.ops.ed.redo()
        assert state() == wanted
    assert bpy.ops.mocap.export_take(filepath=str(tmp_path / "again.bvh"), format="bvh") == {"FINISHED"}
    assert (tmp_path / "again.bvh").read_bytes() == (tmp_path / "take.bvh").read_bytes()


def test_a_changed_look_is_undone(mocap, rig: Rig) -> None:
    """Undo restores the look of the scene and of the body, and the user's own slot."""
    bpy.context.preferences.edit.use_global_undo = True
    name, own = rig.mesh.name, bpy.data.materials.new("Mine").name
    rig.mesh.data.materials.append(bpy.data.materials[own])
    rig.mesh.data.polygons[5].material_index = len(rig.mesh.data.materials) - 1
    mocap.look = SUIT_LOOK
    step("own material")

    def shown() -> tuple[str, str, list[str], list[str], list[float]]:
        mesh = bpy.data.objects[name]
        keys, slots = [key.value for key in mesh.data.shape_keys.key_blocks], [m.name for m in mesh.data.materials]
        faces = [slots[face.material_index] for face in mesh.data.polygons]
        return bpy.context.scene.mocap.look, look_of(mesh), faces, slots, keys

    states = [shown()]
    for look in (MANNEQUIN, SEGMENTS_LOOK, SUIT_LOOK):
        bpy.context.scene.mocap.look = look
        step("Look")
        states.append(shown())
    assert states[0] == states[3] and states[0][2][5] == own
    for wanted in states[2::-1]:
        bpy.ops.ed.undo()
        assert shown() == wanted
    for wanted in states[1:]:
        bpy.ops.ed.redo()
        assert shown() == wanted


def test_a_face_added_in_pose_mode_is_undone(mocap, rig: Rig) -> None:
    bpy.context.preferences.edit.use_global_undo = True
    mocap.review.armature, name = rig.armature, rig.mesh.name
    before = len(rig.mesh.data.shape_keys.key_blocks), len(rig.armature.data.bones), len(rig.mesh.vertex_groups)
    bpy.context.view_layer.objects.active = rig.armature
    bpy.ops.object.mode_set(mode="POSE")
    step("pose mode")
    assert bpy.ops.mocap.add_face() == {"FINISHED"} and bpy.context.mode == "POSE"
    step("face")
    for redo in (False, True):
        (bpy.ops.ed.redo if redo else bpy.ops.ed.undo)()
        mesh, armature = bpy.data.objects[name], bpy.context.scene.mocap.review.armature
        found = len(mesh.data.shape_keys.key_blocks), len(armature.data.bones), len(mesh.vertex_groups)
        assert found == tuple(n + redo * more for n, more in zip(before, (52, 10, 5), strict=True))
