"""Fingers leave Blender in every format, and come back."""

from __future__ import annotations

import bpy
import numpy as np
import pytest

from blender_addon._exchange.body_layout import SMPL_HANDS
from blender_addon._exchange.motion_file import read_motion
from blender_addon.animation.deviation import evaluated_joints, evaluated_vertices
from blender_addon.body.body_file import default_body_path, pose_joints, read_body, with_own_hands
from blender_addon.export.formats import FORMATS
from blender_addon.export.take import take_of
from blender_addon.export.write import export_take
from blender_addon.scene.bake import BakeSettings, bake_take
from solver_backend.io.motions.amass import read_amass
from solver_backend.io.motions.bvh import read_bvh
from tests.support.moving_fingers import FRAMES, moving_fingers


@pytest.fixture
def exported(scene, tmp_path):
    """Return a function that exports a take with fingers; its joints (F, 52, 3); and its motion."""
    body, motion = read_body(default_body_path(), SMPL_HANDS), moving_fingers()
    take = bake_take(scene, motion, body, settings=BakeSettings(floor=False))
    joints = np.stack([evaluated_joints(scene, take.armature, frame) for frame in range(1, FRAMES + 1)])

    def export(name):
        path = tmp_path / f"take{FORMATS[name].suffix}"
        return export_take(take_of(scene, take.armature), name, path)

    return export, joints, motion


def test_bvh(exported):
    export, joints, _ = exported
    clip = read_bvh(export("bvh"))
    order = [clip.names.index(joint) for joint in SMPL_HANDS.joints]
    assert np.linalg.norm(clip.positions()[:, order] - joints, axis=-1).max() < 1e-4


@pytest.mark.parametrize(
    ("name", "operator"),
    [("fbx", "import_scene.fbx"), ("gltf", "import_scene.gltf"), ("usd", "wm.usd_import")],
)
def test_skeletons(exported, name, operator):
    export, joints, _ = exported
    path = export(name)
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    scene.render.fps = 30
    group, function = operator.split(".")
    assert getattr(getattr(bpy.ops, group), function)(filepath=str(path)) == {"FINISHED"}
    [rig] = [obj for obj in bpy.data.objects if obj.type == "ARMATURE"]
    assert set(SMPL_HANDS.joints) <= set(rig.data.bones.keys())
    start = rig.animation_data.action.frame_range[0]
    found = np.stack([evaluated_joints(scene, rig, start + frame) for frame in range(FRAMES)])
    assert np.linalg.norm(found - joints, axis=-1).max() < 1e-3


@pytest.mark.parametrize(("name", "width"), [("amass", 156), ("amass-x", 165)])
def test_amass(exported, name, width):
    export, joints, motion = exported
    path = export(name)
    with np.load(path) as stored:
        assert stored["poses"].shape == (FRAMES, width)
    clip = read_amass(path)
    assert clip.hand_pose is not None and clip.hand_pose.shape == (FRAMES, 90)
    assert np.abs(clip.hand_pose.reshape(FRAMES, 30, 3) - motion.rotvec[:, 22:]).max() > 0.2, "from a flat hand"
    body = read_body(default_body_path(), SMPL_HANDS)
    again = with_own_hands(read_motion(path), body)
    _, found = pose_joints(body.rest_joints(again.betas), again.rotvec, again.transl)
    np.testing.assert_allclose(found, joints, atol=2e-4)


def test_alembic(scene, tmp_path):
    body, motion = read_body(default_body_path(), SMPL_HANDS), moving_fingers()
    take = bake_take(scene, motion, body, settings=BakeSettings(floor=False))
    frames = (0, FRAMES // 2, FRAMES - 1)
    skin = np.stack([evaluated_vertices(scene, take.mesh, 1 + frame) for frame in frames])
    tips = body.weights[:, [SMPL_HANDS.joints.index(f"left_{finger}3") for finger in ("index", "ring")]].argmax(axis=0)
    wrist = body.weights[:, SMPL_HANDS.joints.index("left_wrist")].argmax()
    reach = np.linalg.norm(skin[:, tips] - skin[:, [wrist]], axis=-1)
    assert np.ptp(reach, axis=0).min() > 0.005, "fingers bend, so that tips come nearer to the wrist"
    path = export_take(take_of(scene, take.armature), "alembic", tmp_path / "take.abc")
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    scene.render.fps = 30
    assert bpy.ops.wm.alembic_import(filepath=str(path), set_frame_range=True) == {"FINISHED"}
    [mesh] = [obj for obj in bpy.data.objects if obj.type == "MESH"]
    found = np.stack([evaluated_vertices(scene, mesh, 1 + frame) for frame in frames])
    assert np.linalg.norm(found - skin, axis=-1).max() < 1e-3


def test_tables(exported):
    export, joints, _ = exported
    lines = export("trc").read_text(encoding="utf-8").split("\n")
    assert lines[3].split("\t")[2::3] == list(SMPL_HANDS.joints)
    rows = np.array([line.split("\t") for line in lines[6:] if line], float)
    x, y, z = np.moveaxis(rows[:, 2:].reshape(FRAMES, 52, 3) / 1000, -1, 0)
    np.testing.assert_allclose(np.stack([x, -z, y], -1), joints, atol=1e-6)
    names, *rows = export("csv").read_text(encoding="utf-8").splitlines()
    assert [name.removesuffix("_x_m") for name in names.split(",")[2::3]] == list(SMPL_HANDS.joints)
    table = np.array([row.split(",") for row in rows], float)
    np.testing.assert_allclose(table[:, 2:].reshape(FRAMES, 52, 3), joints, atol=1e-6)
