"""A face in files: its shape keys and their animation reach FBX, glTF and USD, at the take's own frames."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
import pytest

from blender_addon.animation.deviation import evaluated_vertices
from blender_addon.body.body_file import BodyFile
from blender_addon.body.face import add_face_bones, add_face_shapes
from blender_addon.body.mesh import positions
from blender_addon.body.rig import Rig
from blender_addon.body.shape import set_betas
from blender_addon.conventions.coordinates import R_ARMATURE_BODY
from blender_addon.export.formats import FORMATS
from blender_addon.export.take import take_of
from blender_addon.export.write import export_take
from solver_backend.live.face_source import BLEND_SHAPES

READERS = {"fbx": bpy.ops.import_scene.fbx, "gltf": bpy.ops.import_scene.gltf, "usd": bpy.ops.wm.usd_import}
FRAMES = (1.0, 8.0)


@pytest.fixture
def speaking(scene: bpy.types.Scene, rig: Rig, body: BodyFile) -> Rig:
    """Return a body that opens its jaw and turns its head from frame 1 to 8, in a shape of its own."""
    set_betas(rig.mesh, np.linspace(1.0, -1.0, 10))
    add_face_shapes(rig.mesh, body)
    add_face_bones(rig.armature, rig.mesh, body)
    keys, head = rig.mesh.data.shape_keys, rig.armature.pose.bones["head"]
    keys.key_blocks["eyeBlinkLeft"].value = 0.5
    for frame, value in zip(FRAMES, (0.0, 1.0), strict=True):
        keys.key_blocks["jawOpen"].value = value
        keys.key_blocks["jawOpen"].keyframe_insert("value", frame=frame)
        head.rotation_quaternion = (1.0, 0.0, 0.3 * value, 0.0)
        head.keyframe_insert("rotation_quaternion", frame=frame)
        rig.armature.pose.bones["jaw"].rotation_quaternion = (1.0, 0.05 * value, 0.0, 0.0)
        rig.armature.pose.bones["jaw"].keyframe_insert("rotation_quaternion", frame=frame)
    scene.frame_set(1)
    return rig


@pytest.mark.parametrize("name", READERS)
def test_the_face_moves_in_files(scene: bpy.types.Scene, speaking: Rig, tmp_path: Path, name: str) -> None:
    keys, moved = speaking.mesh.data.shape_keys.key_blocks, speaking.mesh.name
    away = np.linalg.norm(positions(keys["jawOpen"].points) - positions(keys["Basis"].points), axis=1)
    lip, times = int(away.argmax()), np.array([1.0, 5.0, 7.0])
    shown = np.stack([evaluated_vertices(scene, speaking.mesh, time)[lip] for time in times])
    before = {key.name: key.value for key in keys}
    scene.render.fps = 24
    bpy.context.window.view_layer = layer = scene.view_layers.new("Second")
    bpy.data.scenes.new("AAA")  # the scene that Blender shows when it removes the one on show
    export_take(take_of(scene, speaking.armature, fps=12.0), name, tmp_path / f"face{FORMATS[name].suffix}")
    assert (bpy.context.window.scene, bpy.context.window.view_layer) == (scene, layer)
    assert {key.name: key.value for key in speaking.mesh.data.shape_keys.key_blocks} == before
    assert [obj.name for obj in scene.objects if obj.type == "MESH" and not obj.hide_render] == [moved]
    [path] = tmp_path.iterdir()
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.context.scene.render.fps = 12
    assert READERS[name](filepath=str(path)) == {"FINISHED"}
    assert {"jaw", "left_eye", "right_eyelid"} <= {bone.name for bone in bpy.data.armatures[0].bones}
    [mesh] = [obj for obj in bpy.data.objects if obj.type == "MESH" and obj.data.shape_keys]
    blocks = mesh.data.shape_keys.key_blocks
    assert {key.name for key in list(blocks)[1:]} == set(BLEND_SHAPES)
    first = mesh.data.shape_keys.animation_data.action.frame_range[0]
    point = (
        lip
        if name == "fbx"
        else int(np.linalg.norm(evaluated_vertices(bpy.context.scene, mesh, first) - shown[0], axis=1).argmin())
    )
    found = [evaluated_vertices(bpy.context.scene, mesh, first + (time - 1) / 2)[point] for time in times]
    np.testing.assert_allclose(found, shown, atol=1e-3)
    assert blocks["eyeBlinkLeft"].value == pytest.approx(0.5, abs=1e-3)


def test_jaw_and_eyes_turn_in_smpl_x(scene: bpy.types.Scene, speaking: Rig, body: BodyFile, tmp_path: Path) -> None:
    """A shape and a bone add up. A hat on the armature does not matter."""
    hat = bpy.data.objects.new("Hat", bpy.data.meshes.new("Hat"))
    scene.collection.objects.link(hat)
    hat.data.from_pydata([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [], [(0, 1, 2)])
    hat.modifiers.new("Armature", "ARMATURE").object, hat.parent = speaking.armature, speaking.armature
    betas = np.linspace(1.0, -1.0, 10)
    stated = {"betas": betas.tolist(), "rest_pelvis": body.rest_joints(betas)[0].tolist(), "body": body.id}
    for key, value in stated.items():
        speaking.armature[key] = value
    speaking.mesh.data.shape_keys.key_blocks["eyeLookOutRight"].value = 0.5
    path = export_take(take_of(scene, speaking.armature), "amass-x", tmp_path / "face.npz")
    axis = np.array(speaking.armature.data.bones["jaw"].matrix_local)[:3, 0] @ R_ARMATURE_BODY
    with np.load(path) as stored:
        np.testing.assert_allclose(stored["pose_jaw"][0], 0.0, atol=1e-5)
        by_bone = 2 * np.arctan(0.05) * axis
        np.testing.assert_allclose(stored["pose_jaw"][-1], np.deg2rad([19.0, 0.0, 0.0]) + by_bone, atol=1e-4)
        np.testing.assert_allclose(stored["pose_eye"], np.deg2rad([[0, 0, 0, 0, -12.5, 0]] * 8), atol=1e-5)
        np.testing.assert_array_equal(stored["poses"][:, 66:69], stored["pose_jaw"])
