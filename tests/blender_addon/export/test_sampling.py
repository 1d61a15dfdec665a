"""Exports are sampled by time: at the take's own rate or a chosen one, from scenes of any rate and unit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest

from blender_addon.animation.deviation import evaluated_joints, evaluated_vertices
from blender_addon.conventions.skeleton import JOINTS
from blender_addon.conventions.timing import set_scene_frame_rate
from blender_addon.errors import ExporterMissing, NothingToExport
from blender_addon.export.formats import FORMATS
from blender_addon.export.take import take_of
from blender_addon.export.write import export_take
from blender_addon.scene.bake import BakedTake, BakeSettings, bake_take
from solver_backend.io.motions.bvh import read_bvh


@pytest.fixture
def in_slow_scene(scene: bpy.types.Scene, files: Any) -> BakedTake:
    """Return a take of 60 frames at 60 a second in a scene of 24 a second."""
    set_scene_frame_rate(scene, 24.0)
    return bake_take(scene, replace(files.motion, fps=60.0), files.body, settings=BakeSettings(set_scene=False))


def table(scene: bpy.types.Scene, take: BakedTake, path: Path, fps: float | None = None) -> np.ndarray:
    export_take(take_of(scene, take.armature, fps=fps), "csv", path)
    return np.genfromtxt(path, delimiter=",", skip_header=1)


@pytest.mark.parametrize("scene_fps", [24.0, 25.0, 29.97, 30.0, 60.0, 120.0])
def test_a_take_has_its_length_from_a_scene_of_any_rate(
    scene: bpy.types.Scene, files: Any, tmp_path: Path, scene_fps: float
) -> None:
    set_scene_frame_rate(scene, scene_fps)
    motion = replace(files.motion, fps=60.0)
    take = bake_take(scene, motion, files.body, settings=BakeSettings(frame_start=101, set_scene=False))
    rows = table(scene, take, tmp_path / "take.csv")
    np.testing.assert_allclose(rows[:, 1], np.arange(60) / 60, atol=1e-8)
    np.testing.assert_allclose(rows[:, 2:].reshape(60, 24, 3), motion.joints, atol=1e-3)


def test_a_take_has_its_length_after_the_scenes_rate_was_changed(
    scene: bpy.types.Scene, take: BakedTake, files: Any, tmp_path: Path
) -> None:
    set_scene_frame_rate(scene, 24.0)
    rows = table(scene, take, tmp_path / "take.csv")
    np.testing.assert_allclose(rows[:, 1], np.arange(60) / files.motion.fps, atol=1e-8)


@pytest.mark.parametrize("fps", [24.0, 29.97, 30.0, 120.0])
def test_a_chosen_rate(
    scene: bpy.types.Scene, in_slow_scene: BakedTake, files: Any, tmp_path: Path, fps: float
) -> None:
    rows = table(scene, in_slow_scene, tmp_path / "take.csv", fps)
    assert len(rows) == 1 + int(59 / 60 * fps + 0.01)
    times = np.arange(60) / 60
    for column in range(72):
        expected = np.interp(rows[:, 1], times, files.motion.joints.reshape(60, -1)[:, column])
        assert np.abs(rows[:, 2 + column] - expected).max() < 0.01


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize(("name", "operator", "settings"), [
    ("bvh", "import_anim.bvh", {"global_scale": 0.01, "update_scene_fps": True, "use_fps_scale": False}),
    ("fbx", "import_scene.fbx", {}),
    ("gltf", "import_scene.gltf", {}),
    ("usd", "wm.usd_import", {}),
])  # fmt: skip
@pytest.mark.parametrize("unit", [1.0, 0.01])
def test_every_skeleton_format_from_a_slow_scene(
    scene: bpy.types.Scene, files: Any, tmp_path: Path, name: str, operator: str, settings: dict[str, Any], unit: float
) -> None:
    """60 frames a second from a scene of 24, in metres or centimetres, under a turned and scaled parent."""
    set_scene_frame_rate(scene, 24.0)
    scene.unit_settings.scale_length = unit
    take = bake_take(scene, replace(files.motion, fps=60.0), files.body, settings=BakeSettings(set_scene=False))
    parent = bpy.data.objects.new("parent", None)
    scene.collection.objects.link(parent)
    parent.rotation_euler, parent.scale = (0.0, 0.0, 0.8), (2.0, 2.0, 2.0)
    take.armature.parent = parent
    times = 1 + np.arange(60) * 24 / 60
    expected = unit * np.stack([evaluated_joints(scene, take.armature, float(time)) for time in times])
    assert np.ptp(expected[0, :, 2]) > 2.5, "twice as large as a person"
    path = tmp_path / f"take{FORMATS[name].suffix}"
    before = scene.render.fps, scene.render.fps_base, scene.unit_settings.scale_length, sorted(bpy.data.objects.keys())
    try:
        export_take(take_of(scene, take.armature), name, path)
    except ExporterMissing as missing:
        pytest.skip(str(missing))
    after = scene.render.fps, scene.render.fps_base, scene.unit_settings.scale_length, sorted(bpy.data.objects.keys())
    assert after == before
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    set_scene_frame_rate(scene, 60.0)
    group, verb = operator.split(".")
    assert getattr(getattr(bpy.ops, group), verb)(filepath=str(path), **settings) == {"FINISHED"}
    [rig] = [obj for obj in bpy.data.objects if obj.type == "ARMATURE"]
    start, end = rig.animation_data.action.frame_range
    assert end - start == pytest.approx(59, abs=1e-3)
    found = np.stack([evaluated_joints(scene, rig, start + frame) for frame in range(60)])
    assert np.linalg.norm(found - expected, axis=-1).max() < 2e-3
    assert set(JOINTS) <= {bone.name for bone in rig.data.bones}


@pytest.mark.parametrize("unit", [1.0, pytest.param(0.01, marks=pytest.mark.slow)])
def test_alembic_from_a_slow_scene(scene: bpy.types.Scene, files: Any, tmp_path: Path, unit: float) -> None:
    set_scene_frame_rate(scene, 24.0)
    scene.unit_settings.scale_length = unit
    take = bake_take(scene, replace(files.motion, fps=60.0), files.body, settings=BakeSettings(set_scene=False))
    frames = (0, 7, 31, 59)
    expected = unit * np.stack([evaluated_vertices(scene, take.mesh, 1 + frame * 24 / 60) for frame in frames])
    names = sorted(bpy.data.objects.keys()), sorted(bpy.data.meshes.keys())
    try:
        export_take(take_of(scene, take.armature), "alembic", tmp_path / "take.abc")
    except ExporterMissing as missing:
        pytest.skip(str(missing))
    assert (sorted(bpy.data.objects.keys()), sorted(bpy.data.meshes.keys())) == names
    assert scene.unit_settings.scale_length == pytest.approx(unit)
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    set_scene_frame_rate(scene, 60.0)
    assert bpy.ops.wm.alembic_import(filepath=str(tmp_path / "take.abc"), set_frame_range=True) == {"FINISHED"}
    assert (scene.frame_start, scene.frame_end) == (1, 60)
    [mesh] = [obj for obj in bpy.data.objects if obj.type == "MESH"]
    found = np.stack([evaluated_vertices(scene, mesh, 1 + frame) for frame in frames])
    assert np.linalg.norm(found - expected, axis=-1).max() < 1e-3


def test_what_cannot_be_sampled_is_named(scene: bpy.types.Scene, in_slow_scene: BakedTake, tmp_path: Path) -> None:
    for stretched in (2.0, 1.0003):
        in_slow_scene.armature.scale = (1.0, stretched, 1.0)
        bpy.context.view_layer.update()
        with pytest.raises(NothingToExport, match="The armature is mirrored or not scaled"):
            export_take(take_of(scene, in_slow_scene.armature), "bvh", tmp_path / "take.bvh")
    in_slow_scene.armature.scale = (2.0, 2.0, 2.0)
    bpy.context.view_layer.update()
    with pytest.raises(NothingToExport, match="The armature is scaled.*AMASS files have no scale"):
        export_take(take_of(scene, in_slow_scene.armature), "amass", tmp_path / "take.npz")
    export_take(take_of(scene, in_slow_scene.armature), "bvh", tmp_path / "take.bvh")
    assert read_bvh(tmp_path / "take.bvh").fps == pytest.approx(60.0, rel=1e-6)
