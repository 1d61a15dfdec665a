"""The cameras panel acts: views and stretches of them are left out, and the calibration is refined and restored."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import pytest

from blender_addon.animation.takes import takes_of
from blender_addon.conventions.kept_findings import findings_in, findings_text
from blender_addon.ui import viewport
from blender_addon.ui.scene_job import prepare_job
from solver_backend.exchange.diagnostics import diagnostic
from solver_backend.geometry.rotations import exp_so3
from solver_backend.io.native.capture_file import write_capture
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.synthesis.simulation.keypoint_detector import miscalibrated
from tests.support.narrow_layout import draw_panel


def job_settings() -> dict:
    return dict(prepare_job(bpy.context.scene, None)[0].settings)


def test_a_camera_and_a_range_are_left_out_of_the_next_solve(solved_take, mocap, scene) -> None:
    assert "leave_out" not in job_settings()
    front, left = (item.name for item in list(mocap.capture.cameras)[:2])
    mocap.capture.cameras[0].use = False
    mocap.review.first, mocap.review.last = 6, 15
    assert bpy.ops.mocap.leave_out_range(index=1) == {"FINISHED"}
    assert job_settings()["leave_out"] == [front, f"{left}:5-14"]
    # Ranges are laid by time as everything else is.
    scene.render.fps = 30
    assert bpy.ops.mocap.follow_rate() == {"FINISHED"}
    assert job_settings()["leave_out"][1] in (f"{left}:4-14", f"{left}:6-14", f"{left}:4-16", f"{left}:6-16")
    assert bpy.ops.mocap.use_range(index=0) == {"FINISHED"}
    assert job_settings()["leave_out"] == [front]
    for item in mocap.capture.cameras:
        item.use = False
    assert bpy.ops.mocap.solve.poll()
    with pytest.raises(RuntimeError, match="No camera with detections is left"):
        bpy.ops.mocap.solve()


@pytest.mark.slow
def test_the_calibration_is_checked_and_what_is_wrong_is_said(mocap, tmp_path: Path) -> None:
    demo = demo_capture()
    assert demo.cameras is not None and demo.keypoints is not None
    assert not bpy.ops.mocap.check_cameras.poll()
    small = replace(demo.cameras, t=0.7 * demo.cameras.t)
    turned = demo.cameras.R.copy()
    turned[2] = exp_so3(np.array([0.01, 0.03, 0.0])) @ turned[2]
    moved = replace(demo.cameras, R=turned, t=-np.einsum("cij,cj->ci", turned, demo.cameras.centres))
    for name, cameras, wrong, doubted in (
        ("fits", demo.cameras, False, []),
        ("small", small, True, []),
        ("moved", moved, False, [demo.cameras.names[2]]),
    ):
        capture = replace(demo, name=name, cameras=cameras, keypoints=demo.keypoints.frames(0, 60), truth={})
        source = write_capture(tmp_path / f"{name}.npz", capture)
        assert bpy.ops.mocap.import_capture(filepath=str(source)) == {"FINISHED"}
        before = [item.object.matrix_world.copy() for item in mocap.capture.cameras]
        assert bpy.ops.mocap.check_cameras() == {"FINISHED"}
        assert mocap.capture.checked[0].isupper()
        assert "m tall" in mocap.capture.checked and "px at best" in mocap.capture.checked
        shown = " ".join(draw_panel(bpy.types.VIEW3D_PT_mocap_cameras, 400).drawn)
        assert ("squares may not have the stated size" in shown) == wrong
        found = findings_in(mocap.capture.check_findings)
        assert {camera for item in found for camera in item.where.cameras} == {*doubted}
        assert mocap.capture.suspect_cameras >= {*doubted}
        assert bool(found) == bool(wrong or doubted)
        assert [item.object.matrix_world for item in mocap.capture.cameras] == before


@pytest.mark.slow
def test_the_calibration_is_refined_and_restored(mocap, tmp_path: Path) -> None:
    demo = demo_capture()
    assert demo.cameras is not None and demo.keypoints is not None
    turned = miscalibrated(demo.cameras, np.array([0.0, 0.0, 0.95]), 25.0, np.random.default_rng(0))
    source = write_capture(
        tmp_path / "off.npz", replace(demo, cameras=turned, keypoints=demo.keypoints.frames(0, 60), truth={})
    )
    assert bpy.ops.mocap.import_capture(filepath=str(source)) == {"FINISHED"}
    capture = mocap.capture
    files, take = capture.file, bpy.data.actions.new("take")
    take["capture_file"] = files
    camera = capture.cameras[0].object
    camera.name, where = "Meine Kamera", camera.matrix_world.copy()
    capture.cameras[3].use = False
    assert not bpy.ops.mocap.restore_cameras.poll()
    assert bpy.ops.mocap.refine_cameras() == {"FINISHED"}
    capture = mocap.capture
    assert len(mocap.captures) == 1 and capture.original == files != capture.file
    assert capture.cameras[0].object == camera and camera.name == "Meine Kamera" and not capture.cameras[3].use
    assert capture.cameras[0].after_px > 0 and "px before" in capture.refined_text()
    assert 1e-6 < (camera.matrix_world.translation - where.translation).length < 0.2
    assert takes_of(capture.measured, "", capture.original) == [take]
    assert Path(prepare_job(bpy.context.scene, None)[0].capture).name == "capture_refined_01.npz"
    assert bpy.ops.mocap.restore_cameras() == {"FINISHED"}
    capture = mocap.capture
    assert capture.file == files and not capture.original and not capture.refined_text()
    assert (camera.matrix_world.translation - where.translation).length < 1e-6
    beside = sorted(path.name for path in Path(bpy.path.abspath(files)).parent.glob("capture*.npz"))
    assert beside == ["capture.npz", "capture_refined_01.npz"]


def test_a_camera_is_doubtful_where_a_diagnostic_names_it_and_not_where_its_name_is_a_word(mocap, tmp_path) -> None:
    demo = demo_capture(num_frames=30)
    assert demo.cameras is not None
    capture = replace(
        demo, cameras=replace(demo.cameras, names=("1", "front", "left", "right")), truth={},
        problems=(
            diagnostic("few_views_agree", views=3.0, agreeing=1.0),
            diagnostic("clocks_assumed", reason="The person claps in front of nobody."),
            diagnostic("camera_sees_elsewhere", cameras=["left"]),
        ),
        notes=(diagnostic("clock_estimated", cameras=["right"], method="sound", offset_ms=2.0),),
    )  # fmt: skip
    source = write_capture(tmp_path / "words.npz", capture)
    assert bpy.ops.mocap.import_capture(filepath=str(source)) == {"FINISHED"}
    assert ("left",) in [item.where.cameras for item in mocap.capture.problems]
    assert ("right",) in [item.where.cameras for item in mocap.capture.notes]
    shades = [viewport.shade_of(mocap.capture, item) for item in mocap.capture.cameras]
    assert shades == [viewport.GOOD, viewport.GOOD, viewport.SUSPECT, viewport.GOOD]


def test_cameras_are_outlined_by_what_is_doubtful(solved_take, mocap, scene) -> None:
    capture = mocap.capture
    first, second, third, fourth = capture.cameras
    scene.camera = fourth.object
    third.use = False
    capture.findings = findings_text([diagnostic("image_mirrored", cameras=[second.name])])
    shades = [shade for _, shade in viewport.shaded_cameras(bpy.context)]
    assert shades == [viewport.GOOD, viewport.SUSPECT, viewport.UNUSED]
    capture.findings = ""
    capture.check_findings = findings_text([diagnostic("image_mirrored", cameras=[f"{first.name}1"])])
    assert viewport.shade_of(capture, first) == viewport.GOOD
    cameras = [f"{second.name}1", first.name]
    capture.check_findings = findings_text([diagnostic("camera_sees_elsewhere", cameras=cameras)])
    assert viewport.shade_of(capture, first) == viewport.SUSPECT
    assert viewport.shade_of(capture, second) == viewport.GOOD
    capture.show_agreement = False
    assert list(viewport.shaded_cameras(bpy.context)) == []


def test_an_outline_is_the_picture_and_its_edges_from_the_camera(solved_take, mocap, scene) -> None:
    camera = mocap.capture.cameras[0].object
    ends = np.array(viewport.outline(camera, scene))
    place, forward = np.array(camera.matrix_world.translation), -np.array(camera.matrix_world)[:3, 2]
    assert ends.shape == (16, 3)
    np.testing.assert_allclose(ends[8::2], np.tile(place, (4, 1)), atol=1e-6)
    assert ((ends[:8] - place) @ forward > 0).all()
