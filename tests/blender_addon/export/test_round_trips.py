"""Every format read back: the same joints, frames and frame rate."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest

from blender_addon._exchange.motion_file import read_motion
from blender_addon.animation.deviation import evaluated_joints, evaluated_vertices
from blender_addon.conventions.skeleton import JOINTS
from blender_addon.conventions.timing import scene_frame_rate
from blender_addon.errors import ExporterMissing
from blender_addon.export.formats import FORMATS
from blender_addon.export.take import take_of
from blender_addon.export.write import export_take
from blender_addon.scene.bake import bake_take
from solver_backend.io.motions.amass import read_amass
from solver_backend.io.motions.bvh import read_bvh

TOLERANCE_M = 1e-3
CHECKED = (0, 7, 31, 44, 59)
WRITTEN = ("bvh", "fbx", "gltf", "usd", "alembic", "amass", "trc", "csv")


@dataclass(frozen=True)
class Exported:
    """A file, and what Blender showed when it was written."""

    path: Path
    fps: float
    joints: np.ndarray
    """(60, 24, 3) world metres."""
    vertices: np.ndarray
    """(len(CHECKED), V, 3) world metres."""


@pytest.fixture(scope="module", params=[30.0, 59.94], ids=["30 fps", "59.94 fps"])
def exported(
    request: pytest.FixtureRequest, files: Any, tmp_path_factory: pytest.TempPathFactory
) -> Callable[[str], Exported]:
    """Write a moved and turned take of 60 frames to every format; return a function that returns one of them."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    take = bake_take(scene, replace(files.motion, fps=request.param), files.body, files.capture)
    take.armature.location, take.armature.rotation_euler = (0.3, -0.2, 0.1), (0.0, 0.0, 0.7)
    joints = joints_alone(scene, take.armature, range(1, 61))
    vertices = np.stack([evaluated_vertices(scene, take.mesh, 1 + frame) for frame in CHECKED])
    folder, failed = tmp_path_factory.mktemp("exported"), dict[str, Exception]()
    paths = {name: folder / f"a folder ü of {name}" / f"der Gang 1{FORMATS[name].suffix}" for name in WRITTEN}
    for name, path in paths.items():
        try:
            export_take(take_of(scene, take.armature), name, path)
        except Exception as error:
            failed[name] = error

    def written(name: str) -> Exported:
        if isinstance(error := failed.get(name), ExporterMissing):
            pytest.skip(str(error))
        if error is not None:
            raise error
        assert [p.name for p in paths[name].parent.iterdir()] == [paths[name].name]
        return Exported(paths[name], request.param, joints, vertices)

    return written


def imported(operator: Any, path: Path, fps: float, **settings: Any) -> bpy.types.Scene:
    """Read a file into an empty scene of this frame rate."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    scene.render.fps, scene.render.fps_base = round(fps), round(fps) / fps
    try:
        operator.get_rna_type()
    except KeyError:
        pytest.skip(f"this Blender does not read {path.suffix}")
    assert operator(filepath=str(path), **settings) == {"FINISHED"}
    return scene


def joints_alone(scene: bpy.types.Scene, rig: bpy.types.Object, frames: Iterable[float]) -> np.ndarray:
    """Return the (F, J, 3) joints on some frames, for which nothing but the armature is evaluated."""
    others = [obj for obj in scene.objects if obj != rig and not obj.hide_viewport]
    for obj in others:
        obj.hide_viewport = True
    found = np.stack([evaluated_joints(scene, rig, frame) for frame in frames])
    for obj in others:
        obj.hide_viewport = False
    return found


def armature() -> bpy.types.Object:
    [found] = [obj for obj in bpy.data.objects if obj.type == "ARMATURE"]
    return found


def assert_joints(scene: bpy.types.Scene, source: Exported) -> None:
    """Compare heads of bones by name on all frames, by time, and say that the motion is 60 frames long."""
    rig = armature()
    assert set(JOINTS) <= {bone.name for bone in rig.data.bones}
    step = scene_frame_rate(scene) / source.fps
    start, end = rig.animation_data.action.frame_range
    assert end - start == pytest.approx(59 * step, abs=1e-3)
    found = joints_alone(scene, rig, (start + step * frame for frame in range(60)))
    off_m = np.linalg.norm(found - source.joints, axis=-1)
    assert off_m.max() < TOLERANCE_M, off_m.max(axis=1)


@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")
def test_bvh(exported: Callable[[str], Exported]) -> None:
    source = exported("bvh")
    clip = read_bvh(source.path)
    assert clip.fps == pytest.approx(source.fps, rel=1e-6) and len(clip.rotations) == 60
    order = [clip.names.index(joint) for joint in JOINTS]
    assert np.linalg.norm(clip.positions()[:, order] - source.joints, axis=-1).max() < 1e-5
    settings = {"global_scale": 0.01, "update_scene_fps": True, "update_scene_duration": True, "use_fps_scale": False}
    scene = imported(bpy.ops.import_anim.bvh, source.path, source.fps, **settings)
    assert_joints(scene, source)


def test_bvh_angles_do_not_jump(exported: Callable[[str], Exported]) -> None:
    lines = exported("bvh").path.read_text().splitlines()
    values = np.array([line.split() for line in lines[lines.index("MOTION") + 3 :]], float)
    assert np.abs(np.diff(values[:, 3:], axis=0)).max() < 60


def test_fbx(exported: Callable[[str], Exported]) -> None:
    source = exported("fbx")
    scene = imported(bpy.ops.import_scene.fbx, source.path, 25.0)
    assert scene_frame_rate(scene) == pytest.approx(source.fps, rel=1e-4)
    if source.fps == round(source.fps):  # this importer rounds the rate when it places keys
        assert_joints(imported(bpy.ops.import_scene.fbx, source.path, source.fps), source)
    assert {bone.name for bone in armature().data.bones} == set(JOINTS), "no leaf bones"
    assert [obj.type for obj in bpy.data.objects if obj.type != "ARMATURE"] == ["MESH"], "the take alone"


def test_fbx_in_the_newer_importer(exported: Callable[[str], Exported]) -> None:
    source = exported("fbx")
    scene = imported(bpy.ops.wm.fbx_import, source.path, source.fps)
    assert_joints(scene, source)


def test_gltf(exported: Callable[[str], Exported]) -> None:
    source = exported("gltf")
    scene = imported(bpy.ops.import_scene.gltf, source.path, 50.0)
    assert_joints(scene, source)
    assert len(bpy.data.actions) == 1


def test_usd(exported: Callable[[str], Exported]) -> None:
    source = exported("usd")
    scene = imported(bpy.ops.wm.usd_import, source.path, source.fps, set_frame_range=True)
    assert (scene.frame_start, scene.frame_end) == (1, 60)
    assert scene_frame_rate(scene) == pytest.approx(source.fps, rel=1e-4)
    assert_joints(scene, source)


def test_alembic(exported: Callable[[str], Exported]) -> None:
    source = exported("alembic")
    scene = imported(bpy.ops.wm.alembic_import, source.path, source.fps, set_frame_range=True)
    assert (scene.frame_start, scene.frame_end) == (1, 60)
    [mesh] = [obj for obj in bpy.data.objects if obj.type == "MESH"]
    found = np.stack([evaluated_vertices(scene, mesh, 1 + frame) for frame in CHECKED])
    assert np.linalg.norm(found - source.vertices, axis=-1).max() < TOLERANCE_M


def test_amass(exported: Callable[[str], Exported], files: Any) -> None:
    source = exported("amass")
    clip = read_amass(source.path)
    assert (clip.fps, clip.model, len(clip.transl)) == (pytest.approx(source.fps, rel=1e-6), "smplh", 60)
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    take = bake_take(scene, read_motion(source.path), files.body)
    found = joints_alone(scene, take.armature, range(1, 61))
    assert np.linalg.norm(found - source.joints, axis=-1).max() < 1e-4
    np.testing.assert_allclose(read_motion(source.path).betas, files.motion.betas, atol=1e-6)


def test_trc(exported: Callable[[str], Exported]) -> None:
    source = exported("trc")
    lines = source.path.read_text(encoding="utf-8").split("\n")
    header = dict(zip(lines[1].split("\t"), lines[2].split("\t"), strict=True))
    assert lines[0].startswith("PathFileType\t4\t(X/Y/Z)\t") and header["Units"] == "mm"
    assert float(header["DataRate"]) == float(header["CameraRate"]) == pytest.approx(source.fps, rel=1e-6)
    assert (header["NumFrames"], header["NumMarkers"], header["OrigNumFrames"]) == ("60", "24", "60")
    assert lines[3].split("\t")[2::3] == list(JOINTS)
    assert lines[4].split("\t")[2:5] == ["X1", "Y1", "Z1"] and lines[5] == ""
    rows = np.array([line.split("\t") for line in lines[6:] if line], float)
    np.testing.assert_array_equal(rows[:, 0], range(1, 61))
    np.testing.assert_allclose(rows[:, 1], np.arange(60) / source.fps, atol=1e-8)
    x, y, z = np.moveaxis(rows[:, 2:].reshape(60, 24, 3) / 1000, -1, 0)
    np.testing.assert_allclose(np.stack([x, -z, y], -1), source.joints, atol=1e-6)
    assert (y[:, JOINTS.index("head")] > y[:, JOINTS.index("left_foot")] + 0.5).all(), "Y points up"


def test_csv(exported: Callable[[str], Exported]) -> None:
    source = exported("csv")
    names, *rows = source.path.read_text(encoding="utf-8").splitlines()
    assert names.split(",")[:5] == ["frame", "time_s", "pelvis_x_m", "pelvis_y_m", "pelvis_z_m"]
    table = np.array([row.split(",") for row in rows], float)
    np.testing.assert_array_equal(table[:, 0], range(1, 61))
    np.testing.assert_allclose(table[:, 1] * source.fps, range(60), atol=1e-5)
    np.testing.assert_allclose(table[:, 2:].reshape(60, 24, 3), source.joints, atol=1e-6)
