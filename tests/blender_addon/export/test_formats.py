"""Exporting without surprises: nothing overwritten, nothing half-written, the user's scene as it was."""

from __future__ import annotations

import gc
import json
import sys
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest

from blender_addon._exchange.errors import OutputExists, OutputNotWritable
from blender_addon._exchange.motion_file import read_motion
from blender_addon._exchange.so3 import matrix_from_rotvec, rotvec_from_matrix
from blender_addon.animation.deviation import evaluated_joints
from blender_addon.animation.takes import push_down
from blender_addon.body.body_file import pose_joints
from blender_addon.body.shape import get_betas, set_betas
from blender_addon.conventions.coordinates import euler_from_matrix
from blender_addon.conventions.skeleton import JOINTS
from blender_addon.errors import ExporterMissing, ExportFailed, NothingToExport
from blender_addon.export.formats import FORMATS
from blender_addon.export.take import take_of
from blender_addon.export.write import export_take, file_names, writer_of
from blender_addon.export.writers import blender_exporters
from blender_addon.export.writers.blender_exporters import run_exporter
from blender_addon.scene.bake import BakedTake, bake_take
from solver_backend.io.motions.bvh import read_bvh
from tests.support.full_disk import full_disk
from tests.support.mixamo_rig import mixamo_rig

FEW = (1, 12)  # Frames of a file whose contents do not matter; more than a disk of 6,000 bytes holds.


def test_every_format_has_a_writer() -> None:
    assert [writer_of(row).__name__ for row in FORMATS.values()] == [f"export_{n.replace('-', '_')}" for n in FORMATS]


def test_what_is_there_is_overwritten_only_on_request(scene: Any, take: BakedTake, tmp_path: Path) -> None:
    path = tmp_path / "walk.csv"
    path.write_text("mine")
    with pytest.raises(OutputExists, match=r"walk\.csv already exists"):
        export_take(take_of(scene, take.armature), "csv", path)
    assert path.read_text() == "mine"
    export_take(take_of(scene, take.armature), "csv", path, overwrite=True)
    assert path.read_text().startswith("frame,time_s") and [p.name for p in tmp_path.iterdir()] == ["walk.csv"]


@pytest.mark.parametrize("name", FORMATS)
def test_a_failed_export_leaves_what_was_there(
    scene: Any, take: BakedTake, tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / f"walk{FORMATS[name].suffix}"
    path.write_bytes(b"mine")

    def full_disk(part: Path, *_: object) -> None:
        part.write_bytes(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("blender_addon.export.write.writer_of", lambda _: full_disk)
    with pytest.raises(OutputNotWritable, match=r"No space left on device.*enough free space"):
        export_take(take_of(scene, take.armature), name, path, overwrite=True)
    assert [(p.name, p.read_bytes()) for p in tmp_path.iterdir()] == [(path.name, b"mine")]


@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("name", FORMATS)
def test_a_disk_that_fills_up_half_way(scene: Any, take: BakedTake, tmp_path: Path, name: str) -> None:
    """Blender's exporters meet the same: what they leave behind is cleared away, and the scene stays."""
    path = tmp_path / f"walk{FORMATS[name].suffix}"
    path.write_bytes(b"mine")
    objects = sorted(bpy.data.objects.keys())
    with (
        full_disk(6000),
        pytest.raises(OutputNotWritable, match=r"No space left|File too large|disk may be full"),
    ):
        export_take(take_of(scene, take.armature, FEW), name, path, overwrite=True)
    assert [(p.name, p.read_bytes()) for p in tmp_path.iterdir()] == [(path.name, b"mine")]
    assert sorted(bpy.data.objects.keys()) == objects
    sys.last_traceback = sys.last_value = None  # the glTF exporter's file, which it does not close
    gc.collect()


@pytest.mark.parametrize("name", ["usd", "alembic"])
def test_a_cut_file_is_no_result(
    scene: Any, take: BakedTake, tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a full disk the USD exporter says that it has finished."""
    path = tmp_path / f"walk{FORMATS[name].suffix}"
    try:
        export_take(take_of(scene, take.armature, FEW), name, path)
    except ExporterMissing as missing:
        pytest.skip(str(missing))
    whole = path.read_bytes()
    cut = whole[: len(whole) // 2] if name == "usd" else whole[:5] + b"\0" + whole[6:]
    monkeypatch.setattr(blender_exporters, "run_exporter", lambda _, part, *settings: part.write_bytes(cut))
    with pytest.raises(OutputNotWritable, match="stopped while writing the file"):
        export_take(take_of(scene, take.armature, FEW), name, path, overwrite=True)
    assert path.read_bytes() == whole


@pytest.mark.parametrize("name", ["fbx", "gltf", "usd", "alembic"])
def test_the_users_scene_stays_as_it_was(
    scene: Any, take: BakedTake, files: Any, tmp_path: Path, name: str, capfd: pytest.CaptureFixture[str]
) -> None:
    other = bake_take(scene, files.motion, files.body).armature
    scene.frame_start, scene.frame_end = 3, 17
    scene.frame_set(12)
    for obj in bpy.context.view_layer.objects:
        obj.select_set(obj is other)
    bpy.context.view_layer.objects.active = other
    take.mesh.hide_set(True)
    before = state(scene), evaluated_joints(scene, take.armature, 12)
    try:
        export_take(take_of(scene, take.mesh, FEW), name, tmp_path / f"walk{FORMATS[name].suffix}")
    except ExporterMissing as missing:
        pytest.skip(str(missing))
    assert state(scene) == before[0]
    np.testing.assert_array_equal(evaluated_joints(scene, take.armature, 12), before[1])
    assert "WARN" not in "".join(capfd.readouterr()), "the exporter cannot write something that we hand it"


def state(scene: Any) -> tuple[Any, ...]:
    objects = bpy.context.view_layer.objects
    return (
        [(obj.name, obj.select_get(), obj.hide_get(), obj.hide_viewport) for obj in objects], objects.active,
        scene.frame_start, scene.frame_end, scene.frame_current, scene.render.fps, scene.render.fps_base,
        len(bpy.data.scenes), len(bpy.data.actions), len(bpy.data.objects), bpy.data.filepath,
    )  # fmt: skip


@pytest.mark.parametrize("name", ["fbx", "gltf"])
def test_another_rig_keeps_its_modifiers_and_its_skin_in_the_file(scene: Any, tmp_path: Path, name: str) -> None:
    rig = mixamo_rig()
    data = bpy.data.meshes.new("Skin")
    data.from_pydata([(0, 0, 0), (0, 1, 0), (1, 0, 0)], [], [(0, 1, 2)])
    mesh = bpy.data.objects.new("Skin", data)
    scene.collection.objects.link(mesh)
    mesh.parent = rig
    mesh.vertex_groups.new(name="mixamorig:Hips").add([0, 1, 2], 1.0, "ADD")
    mesh.modifiers.new("Armature", "ARMATURE").object = rig
    mesh.modifiers.new("Subdivision", "SUBSURF").show_viewport = False
    hips = rig.pose.bones["mixamorig:Hips"]
    for frame in (1, 10):
        hips.location = (0, frame, 0)
        hips.keyframe_insert("location", frame=frame)
    path = tmp_path / f"walk{FORMATS[name].suffix}"
    export_take(take_of(scene, rig, (1, 10)), name, path)
    assert [modifier.show_viewport for modifier in mesh.modifiers] == [True, False]
    importer = bpy.ops.import_scene.fbx if name == "fbx" else bpy.ops.import_scene.gltf
    before = set(bpy.data.objects)
    importer(filepath=str(path))
    [read] = [obj for obj in set(bpy.data.objects) - before if obj.type == "MESH" and obj.vertex_groups]
    assert len(read.data.vertices) == 3 and [m.type for m in read.modifiers] == ["ARMATURE"]


def test_a_range_of_frames(scene: Any, take: BakedTake, tmp_path: Path) -> None:
    export_take(take_of(scene, take.armature, (11, 20)), "csv", tmp_path / "part.csv")
    table = np.genfromtxt(tmp_path / "part.csv", delimiter=",", skip_header=1)
    assert table[:, 0].tolist() == list(range(11, 21)) and table[0, 1] == 0
    np.testing.assert_allclose(table[0, 2:].reshape(24, 3), evaluated_joints(scene, take.armature, 11), atol=1e-6)


def test_what_the_user_did_to_the_take_is_exported(scene: Any, take: BakedTake, files: Any, tmp_path: Path) -> None:
    """Another shape, a take on the NLA and a constraint."""
    betas = get_betas(take.mesh)
    set_betas(take.mesh, betas + np.array([1.5, -1, 0, 0, 0, 0, 0, 0, 0, 0]))
    push_down(take.armature)
    take.armature.animation_data.nla_tracks[0].mute = False
    take.armature.pose.bones["left_wrist"].constraints.new("LIMIT_ROTATION").use_limit_x = True
    expected = np.stack([evaluated_joints(scene, take.armature, frame) for frame in (1, 30)])
    assert np.linalg.norm(expected[1] - files.motion.joints[29], axis=-1).max() > 0.01
    exported = take_of(scene, take.armature, (1, 60))
    export_take(exported, "bvh", tmp_path / "walk.bvh")
    clip = read_bvh(tmp_path / "walk.bvh")
    found = clip.positions()[[0, 29]][:, [clip.names.index(joint) for joint in JOINTS]]
    np.testing.assert_allclose(found, expected, atol=1e-4)
    with pytest.raises(NothingToExport, match="shape was changed after the solve"):
        export_take(exported, "amass", tmp_path / "walk.npz")
    take.armature["provenance"] = json.dumps({"settings": {"body": str(files.body_path)}})
    export_take(exported, "amass", tmp_path / "walk.npz")
    motion = read_motion(tmp_path / "walk.npz")
    np.testing.assert_allclose(motion.betas, get_betas(take.mesh), atol=1e-5)
    _, joints = pose_joints(files.body.rest_joints(motion.betas), motion.rotvec[[0, 29]], motion.transl[[0, 29]])
    np.testing.assert_allclose(joints, expected, atol=1e-4)
    take.armature.scale = (2, 2, 1)
    bpy.context.view_layer.update()
    with pytest.raises(NothingToExport, match="The armature is mirrored or not scaled"):
        export_take(exported, "bvh", tmp_path / "scaled.bvh")


def test_what_cannot_be_exported_is_named(scene: Any, take: BakedTake, tmp_path: Path) -> None:
    with pytest.raises(NothingToExport, match="No armature is selected"):
        take_of(scene, None)
    with pytest.raises(NothingToExport, match="No armature is selected"):
        take_of(scene, take.cameras[0])
    with pytest.raises(NothingToExport, match="The frames 9 to 3 are not a valid range"):
        take_of(scene, take.armature, (9, 3))
    with pytest.raises(NothingToExport, match=r"The name of this file must end in \.fbx.*Try walk\.fbx"):
        export_take(take_of(scene, take.armature), "fbx", tmp_path / "walk.obj")
    with pytest.raises(NothingToExport, match="There is no format 'obj'.*Known formats: bvh"):
        export_take(take_of(scene, take.armature), "obj", tmp_path / "walk.obj")
    del take.armature["betas"]
    with pytest.raises(NothingToExport, match="does not state its body and shape"):
        export_take(take_of(scene, take.armature), "amass", tmp_path / "walk.npz")
    bpy.data.objects.remove(take.mesh)
    with pytest.raises(NothingToExport, match="does not deform a mesh"):
        export_take(take_of(scene, take.armature), "alembic", tmp_path / "walk.abc")
    take.armature.data.bones["left_knee"].name = "knee.L"
    with pytest.raises(NothingToExport, match="does not have the bones left_knee"):
        export_take(take_of(scene, take.armature), "trc", tmp_path / "walk.trc")
    take.armature.animation_data_clear()
    with pytest.raises(NothingToExport, match="has no current action"):
        take_of(scene, take.armature)
    bpy.context.view_layer.layer_collection.children[take.collection.name].exclude = True
    with pytest.raises(NothingToExport, match="Enable its collection"):
        export_take(take_of(scene, take.armature, (1, 2)), "fbx", tmp_path / "walk.fbx")
    assert not list(tmp_path.iterdir())


def test_blenders_refusals_are_named(scene: Any, tmp_path: Path) -> None:
    with pytest.raises(ExporterMissing, match="cannot write XYZ"):
        run_exporter(bpy.ops.export_scene.no_such_format, tmp_path / "a.xyz", {})
    with pytest.raises(ExportFailed, match="exporter failed"):
        run_exporter(bpy.ops.export_anim.bvh, tmp_path / "a.bvh", {})


def test_euler_angles_are_the_rotation_and_continuous_past_the_pole() -> None:
    at = np.linspace(0, 4 * np.pi, 400)
    rotvec = np.stack([at, 0.3 * np.sin(at), 0.2 * np.cos(at)], axis=-1)[:, None]
    R = matrix_from_rotvec(rotvec)
    z, x, y = np.moveaxis(euler_from_matrix(R, "YXZ")[..., [2, 0, 1]], -1, 0)
    turn = lambda axis, angle: matrix_from_rotvec(angle[..., None] * np.eye(3)[axis])  # noqa: E731
    np.testing.assert_allclose(turn(2, z) @ turn(0, x) @ turn(1, y), R, atol=1e-12)
    assert np.abs(np.diff(x, axis=0)).max() < 0.1


def test_axis_angles_of_matrices_at_all_angles() -> None:
    rng = np.random.default_rng(0)
    axis = rng.normal(size=(200, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    angle = np.concatenate([[0.0, 1e-9, 1e-4, np.pi - 1e-9], rng.uniform(0, np.pi, 196)])[:, None]
    found = rotvec_from_matrix(matrix_from_rotvec(axis * angle))
    np.testing.assert_allclose(found[:3], (axis * angle)[:3], atol=1e-12)
    np.testing.assert_allclose(found[4:], (axis * angle)[4:], atol=1e-7)
    np.testing.assert_allclose(matrix_from_rotvec(found), matrix_from_rotvec(axis * angle), atol=1e-12)


def test_two_formats_of_one_suffix_get_files_of_their_own():
    names = file_names("take", ["amass", "fbx", "amass-x"])
    assert names == {"amass": "take.npz", "fbx": "take.fbx", "amass-x": "take_amass-x.npz"}
    assert file_names("take", ["amass-x"]) == {"amass-x": "take.npz"}
    with pytest.raises(NothingToExport, match="no format 'xyz'"):
        file_names("take", ["xyz"])
