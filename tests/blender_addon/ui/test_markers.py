"""A recording of markers by the operators: recognised, shown, solved, coloured, with the solver's real process."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import pytest

from blender_addon._exchange.diagnostics import sentence
from blender_addon._exchange.motion_file import read_motion
from blender_addon.scene.overlay import labels_of
from blender_addon.ui.operators.base import SolverOperator
from blender_addon.ui.operators.imports import SUFFIXES
from blender_addon.ui.panels.capture import summarise
from blender_addon.ui.viewport import name_places
from solver_backend.body.label_places import read_label_places
from solver_backend.io.markers.c3d import write_c3d
from solver_backend.io.markers.camera_systems import write_trc
from solver_backend.io.markers.read import read_markers
from solver_backend.job import Job
from solver_backend.synthesis.embedded.demo import record_markers
from solver_backend.types import MarkerCloud
from tests.support.kept_scenes import KeptScene, registered

FRAMES = 40


@pytest.fixture(scope="module")
def cloud() -> MarkerCloud:
    return record_markers(FRAMES).cloud


@pytest.fixture(scope="module")
def take(cloud: MarkerCloud, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_c3d(tmp_path_factory.mktemp("Aufnahme ü") / "walk.c3d", cloud)


@pytest.fixture(scope="module")
def kept_import(take: Path, tmp_path_factory: pytest.TempPathFactory) -> KeptScene[None]:
    """Import the recording into a scene, once."""
    folder = tmp_path_factory.mktemp("kept")

    def imported(scene: bpy.types.Scene) -> None:
        with registered():
            scene.mocap.folder = str(folder)
            assert bpy.ops.mocap.import_capture(filepath=str(take)) == {"FINISHED"}

    return KeptScene(folder / "imported.blend", imported)


@pytest.fixture
def imported(mocap: bpy.types.PropertyGroup, kept_import: KeptScene[None]) -> bpy.types.PropertyGroup:
    mocap.folder = str(Path(mocap.capture.file).parents[1])  # where it was imported
    return mocap.capture


def grades(capture: bpy.types.PropertyGroup) -> np.ndarray:
    values = [item.value for item in capture.cloud.data.attributes["grade"].data]
    return np.array(values).reshape(FRAMES, -1)


def test_a_c3d_is_recognised_and_stands_in_the_scene(imported, take, cloud):
    assert (imported.frames, imported.fps, imported.name) == (FRAMES, 60.0, "walk")
    assert (imported.markers, imported.subjects, len(imported.cameras)) == (42, "Demo", 0)
    assert Path(imported.source) == take and Path(imported.file).parent.name.startswith("walk_")
    kinds = {item.name: item.meaning for item in imported.marker_items}
    assert list(kinds) == list(cloud.labels) == labels_of(imported.cloud)
    assert kinds["Demo:ARMBAND"] == "unknown" and list(kinds.values()).count("known") == 41
    lines = summarise(imported)
    assert lines[:2] == ["41 known, 1 unknown", "Subjects: Demo"] and "gaps in" in lines[2]
    said = [sentence(item) for item in (*imported.problems, *imported.notes)]
    assert any("Lengths are in mm" in text for text in said) and any("Z points up" in text for text in said)
    hidden = int(np.isnan(cloud.positions[:, :, 0]).sum())
    total = sum(item.missing_percent for item in imported.marker_items) / 100 * FRAMES
    assert total == pytest.approx(hidden, abs=0.1) and hidden > 10


def test_it_can_be_dropped_and_so_can_a_trc(mocap, take, cloud, tmp_path):
    assert {".c3d", ".trc", ".csv"} <= set(SUFFIXES)
    done = bpy.ops.mocap.import_capture(directory=str(take.parent), files=[{"name": take.name}])
    assert done == {"FINISHED"} and mocap.capture.name == "walk"
    trc = write_trc(tmp_path / "other.trc", cloud)
    assert bpy.ops.mocap.import_capture(filepath=str(trc)) == {"FINISHED"}
    assert (mocap.capture.name, mocap.capture.markers) == ("other", 42)


@pytest.mark.slow
def test_markers_are_coloured_by_the_take_that_is_shown(mocap, imported):
    assert not grades(imported).any()
    mocap.solve.preset = "FAST"
    assert bpy.ops.mocap.solve() == {"FINISHED"}
    take = mocap.review.take
    motion = read_motion(Path(take["motion_file"]))
    residual = np.array(motion.marker_residual_mm)
    seen = np.isfinite(residual)
    found = grades(imported)
    assert found.shape == residual.shape, "the marker of unknown name has found its bone"
    assert found[seen].min() == 1 and not found[~seen].any()
    near = residual <= 10
    assert ((found == 1) == (near & seen)).all() and near.sum() > 0
    imported.show_residuals = False
    assert not grades(imported).any()
    imported.show_residuals = True
    motion_file = Path(take["motion_file"])
    assert bpy.ops.mocap.solve() == {"FINISHED"} and mocap.review.take != take
    motion_file.unlink()
    assert bpy.ops.mocap.show_take(name=take.name) == {"FINISHED"}
    assert not grades(imported).any()  # the shown take's file is gone


@pytest.mark.slow
def test_the_markers_of_a_take_are_exported(mocap, imported, cloud, tmp_path):
    assert not bpy.ops.mocap.export_markers.poll()
    mocap.solve.preset = "FAST"
    assert bpy.ops.mocap.solve() == {"FINISHED"}
    motion = read_motion(Path(mocap.review.take["motion_file"]))
    for name in ("c3d", "trc"):
        out = tmp_path / f"solved ü.{name}"
        assert bpy.ops.mocap.export_markers(filepath=str(out), format=name, contents="solved") == {"FINISHED"}
        written = read_markers(out).cloud
        assert written.labels == motion.marker_labels and written.fps == cloud.fps
        assert np.abs(written.positions - motion.markers).max() < 1e-5
    with pytest.raises(RuntimeError, match="already exists"):
        bpy.ops.mocap.export_markers(filepath=str(out), format="trc", contents="solved")
    with pytest.raises(RuntimeError, match="needs a saved file"):
        bpy.ops.mocap.export_markers(filepath="//take.c3d", contents="solved")


@pytest.mark.slow
def test_a_calibrated_subject_is_solved_with_and_kept_by_its_path(mocap, imported, cloud, tmp_path):
    assert bpy.ops.mocap.calibrate_subject() == {"FINISHED"}
    subject = Path(mocap.solve.subject)
    assert subject.name == "subject_01.npz" and subject.parent == Path(mocap.capture.file).parent
    mocap.solve.preset = "FAST"
    assert bpy.ops.mocap.solve() == {"FINISHED"}
    take = mocap.review.take
    job = json.loads(Path(take["job_file"]).read_text("utf-8"))
    assert job["subject"] == "subject_01.npz" and "betas" not in job["settings"]
    with np.load(subject) as person:
        assert read_motion(Path(take["motion_file"])).betas == pytest.approx(person["betas"], abs=1e-4)
    out = tmp_path / "cleaned.c3d"
    assert bpy.ops.mocap.export_markers(filepath=str(out), format="c3d", contents="cleaned") == {"FINISHED"}
    cleaned = read_markers(out).cloud
    assert np.isfinite(cleaned.positions).all() and np.isnan(cloud.positions).any()
    assert bpy.ops.mocap.calibrate_subject() == {"FINISHED"}
    assert Path(mocap.solve.subject).name == "subject_02.npz" and subject.is_file()
    Path(mocap.solve.subject).unlink()
    with pytest.raises(RuntimeError, match=r"The file for Subject no longer exists.*subject_02\.npz"):
        bpy.ops.mocap.solve()


def test_a_marker_is_attached_by_hand(mocap, imported, take, monkeypatch):
    imported.marker_items["Demo:ARMBAND"].bone = "left_shoulder"
    imported.marker_items["Demo:C7"].bone = "NONE"
    assert bpy.ops.mocap.import_capture(filepath=str(take)) == {"FINISHED"}  # reading again keeps it
    monkeypatch.setattr(SolverOperator, "launch", lambda *_: {"CANCELLED"})
    bpy.ops.mocap.solve()
    job = max(Path(imported.file).parent.glob("take_*.job.json"))
    settings = Job.read(job).settings
    assert read_label_places(settings.layout) == {"Demo:ARMBAND": "@left_shoulder", "Demo:C7": ""}


def test_reading_again_keeps_the_object_and_what_was_done_to_it(mocap, imported, take):
    cloud = imported.cloud
    cloud.name = "mine"
    imported.show_names = True
    assert bpy.ops.mocap.import_capture(filepath=str(take)) == {"FINISHED"}
    assert mocap.capture.cloud == cloud and cloud.name == "mine" and mocap.capture.show_names
    assert len(mocap.capture.marker_items) == 42
    assert [obj for obj in bpy.data.objects if "marker_labels" in obj] == [cloud]


def test_two_people_are_asked_for_and_one_is_chosen(mocap, cloud, tmp_path):
    both = replace(
        cloud,
        positions=np.concatenate([cloud.positions, cloud.positions + (1.0, 0.0, 0.0)], axis=1),
        labels=(*cloud.labels, *(label.replace("Demo", "Anna") for label in cloud.labels)),
    )
    path = write_c3d(tmp_path / "pair.c3d", both)
    with pytest.raises(RuntimeError, match=r"Demo \(42 markers\), Anna.*in Blender, Subject under Reading Options"):
        bpy.ops.mocap.import_capture(filepath=str(path))
    assert Path(mocap.capture.source) == path and not mocap.capture.file
    mocap.reading.subject_prefix = "Anna"
    assert bpy.ops.mocap.import_capture(filepath=mocap.capture.source) == {"FINISHED"}
    assert mocap.capture.subjects == "Anna" and mocap.capture.markers == 42


def test_a_file_that_is_no_recording_leaves_the_capture_that_is_there(mocap, imported, take, tmp_path):
    wrong = tmp_path / "wrong.c3d"
    wrong.write_bytes(b"nothing of a C3D" * 64)
    with pytest.raises(RuntimeError):
        bpy.ops.mocap.import_capture(filepath=str(wrong))
    assert Path(mocap.capture.source) == take and mocap.capture.markers == 42


def test_the_demo_take_comes_without_a_file(mocap):
    assert bpy.ops.mocap.demo_capture(kind="MARKERS") == {"FINISHED"}
    assert mocap.capture.frames == 240 and mocap.capture.markers == 42
    assert mocap.capture.subjects == "Demo"


def test_names_stand_beside_the_markers_a_viewport_shows(imported, monkeypatch):
    class Region:
        width, height = 800, 600

    class Context:
        scene, region, region_data = bpy.context.scene, Region, None

    monkeypatch.setattr(
        "bpy_extras.view3d_utils.location_3d_to_region_2d",
        lambda region, view, point: None if point.z > 1.0 else point.xy,
    )
    found = name_places(Context, imported.cloud)
    assert "Demo:LTOE" in found and "Demo:LFHD" not in found
