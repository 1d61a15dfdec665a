"""The Live panel: a real child replays a recording, its body moves, what was recorded is there at the end."""

from __future__ import annotations

import time
from pathlib import Path

import bpy
import numpy as np
import pytest

from blender_addon._exchange.errors import MocapError
from blender_addon.animation.action import read_pose
from blender_addon.body.body_file import default_body_path, read_body
from blender_addon.conventions.skeleton import JOINTS
from blender_addon.scene.live_figure import MOST_POINTS, create_live_figure
from blender_addon.scene.point_player import GRADE, SEEN
from blender_addon.ui.operators.live import live
from solver_backend.io.load import load_capture
from solver_backend.priors.weights import ASSETS

DEMO = ASSETS / "demo_markers.c3d"
_LONGEST_S = 60.0


def until(done, *, seconds: float = _LONGEST_S) -> None:
    """Tick as Blender's timer would, until something is so."""
    end = time.monotonic() + seconds
    while not done():
        assert time.monotonic() < end, (live.failure, live.run and list(live.run.log))
        live.tick()
        time.sleep(0.02)


@pytest.fixture
def started(mocap):
    """Return the settings of a scene in which a recording is replayed."""
    mocap.live.source = str(DEMO)
    assert bpy.ops.mocap.live_start() == {"FINISHED"}
    yield mocap
    live.abandon()


def test_a_recording_moves_the_body_and_is_recorded_up_to_the_stop(started):
    run, figure = live.run, live.figure
    assert run is not None and figure is not None
    with pytest.raises(RuntimeError, match="Stop it first"):
        bpy.ops.mocap.live_start()
    until(lambda: run.shown > 2 and run.latest is not None and run.latest.rotvec is not None)
    latest = run.latest
    armature = bpy.data.objects[figure.armature]
    bpy.context.view_layer.update()
    stands = read_pose(armature, figure.body.rest_joints(figure.betas)[0])
    assert np.abs(stands.transl - latest.transl).max() < 1e-5
    assert np.abs(stands.rotvec[:22] - latest.rotvec[:22]).max() < 1e-3
    cloud = bpy.data.objects[figure.points].data
    seen = np.zeros(MOST_POINTS, np.float32)
    cloud.attributes[SEEN].data.foreach_get("value", seen)
    assert int(seen.sum()) == min(len(latest.points), MOST_POINTS)
    assert np.allclose(cloud.vertices[0].co, latest.points[0], atol=1e-4)
    assert bpy.ops.mocap.live_stop() == {"FINISHED"}
    until(lambda: not live.busy)
    assert live.failure == "" and live.recorded
    recorded = load_capture(Path(bpy.path.abspath(live.recorded))).markers
    assert recorded is not None and recorded.positions.shape[1] >= 20
    assert 0 < len(recorded.positions) < len(load_capture(DEMO).markers.positions)
    # What was shown stays to be looked at, and the next run takes its place.
    assert figure.armature in bpy.data.objects
    assert bpy.ops.mocap.live_start() == {"FINISHED"}
    assert sum(o.type == "ARMATURE" for o in bpy.data.objects) == 1


def test_a_body_that_was_taken_away_ends_the_run_with_a_sentence(started):
    run = live.run
    until(lambda: run.shown > 0)
    bpy.data.objects.remove(bpy.data.objects[live.figure.armature])
    until(lambda: not live.busy)
    assert "was deleted" in live.failure


def test_a_body_that_was_taken_away_before_its_first_pose_ends_the_run(started, monkeypatch):
    framed = []
    monkeypatch.setattr(live, "_frame", framed.append)
    bpy.data.objects.remove(bpy.data.objects[live.figure.armature])
    until(lambda: not live.busy)
    assert "was deleted" in live.failure and not framed


def test_a_child_that_dies_is_said_to_have_died(started):
    live.run.process._process.kill()  # from outside
    until(lambda: not live.busy)
    assert "ended without a message" in live.failure


def test_stopping_while_it_starts_is_no_failure(started):
    assert bpy.ops.mocap.live_stop() == {"FINISHED"}
    until(lambda: not live.busy)
    assert live.failure == ""
    # A child that starts fast has frames by then: those are kept.
    assert live.recorded == "" or Path(live.recorded).stat().st_size > 0


def test_another_file_ends_the_run(started):
    process = live.run.process
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    assert not live.busy
    until(lambda: process.exit_code is not None)


def test_a_missing_recording_is_named(mocap, tmp_path):
    mocap.live.source = str(tmp_path / "nowhere.c3d")
    with pytest.raises(RuntimeError, match="does not exist"):
        bpy.ops.mocap.live_start()
    assert not live.busy and not bpy.data.collections


def test_the_figure_stands_where_it_is_told_in_a_scene_of_centimetres(scene):
    scene.unit_settings.scale_length = 0.01
    figure = create_live_figure(scene, read_body(default_body_path()), np.zeros(10))
    rotvec = np.zeros((24, 3))
    rotvec[0], rotvec[4], rotvec[16] = (np.pi / 2, 0, 0), (0.3, 0, 0), (0, 0, -1.0)
    figure.reshape(np.full(10, 0.4))
    assert figure.pose(rotvec, np.array([0.5, -1.0, 0.2]))
    bpy.context.view_layer.update()
    armature = bpy.data.objects[figure.armature]
    pelvis = figure.body.rest_joints(np.full(10, 0.4))[0] + (0.5, -1.0, 0.2)
    at = armature.matrix_world @ armature.pose.bones["pelvis"].head
    assert np.allclose(at, 100.0 * pelvis, atol=1e-2)
    assert figure.show_points(np.ones((500, 3)))
    bpy.data.objects.remove(bpy.data.objects[figure.armature])
    assert not figure.pose(rotvec, np.zeros(3))


def grades_of(name: str, count: int) -> list[int]:
    """Return the colours' numbers of the first points of an overlay."""
    cloud, grade = bpy.data.objects[name].data, np.zeros(MOST_POINTS, np.float32)
    cloud.attributes[GRADE].data.foreach_get("value", grade)
    return grade[:count].astype(int).tolist()


def test_points_and_joints_have_the_colours_of_their_doubt(scene):
    figure = create_live_figure(scene, read_body(default_body_path()), np.zeros(10))
    assert figure.show_points(np.zeros((5, 3)), np.array([0.01, 0.05, 0.2, np.nan, 0.0]))
    assert grades_of(figure.points, 5) == [1, 2, 3, 0, 1]
    assert figure.show_points(np.zeros((5, 3)))
    assert grades_of(figure.points, 5) == [0] * 5
    rotvec, transl, sigma = np.zeros((24, 3)), np.array([0.0, 0.0, 0.9]), np.full(24, 0.01)
    sigma[:3] = 0.03, 0.2, np.nan
    assert figure.show_doubt(rotvec, transl, sigma, unsure=False)
    assert grades_of(figure.joints, 5) == [2, 3, 3, 1, 1]
    assert figure.pose(rotvec, transl)
    bpy.context.view_layer.update()
    places = np.array([v.co for v in bpy.data.objects[figure.joints].data.vertices[:24]])
    heads = np.array([bpy.data.objects[figure.armature].pose.bones[name].head for name in JOINTS])
    assert np.abs(places - heads).max() < 1e-4
    assert figure.show_doubt(rotvec, transl, sigma, unsure=True)
    assert grades_of(figure.joints, 5) == [2, 3, 3, 2, 2]
    bpy.data.objects.remove(bpy.data.objects[figure.joints])
    assert not figure.show_doubt(rotvec, transl, sigma, unsure=True)


class Refused(MocapError):
    """Ends a start before a process is made."""


@pytest.fixture
def asked(monkeypatch) -> list:
    """Return what live runs are asked for; none is started."""
    calls: list = []

    def start(*arguments, **options):
        calls.append((arguments, options))
        raise Refused("not started")

    monkeypatch.setattr("blender_addon.solving.live.start_live", start)
    return calls


def test_cameras_and_videos_are_passed_on_with_calibration_detector_and_recording(mocap, asked, tmp_path):
    settings = mocap.live
    settings.kind = "CAMERAS"
    with pytest.raises(RuntimeError, match="Enter the cameras"):
        bpy.ops.mocap.live_start()
    video, calibration = tmp_path / "a film.mp4", tmp_path / "calibration.toml"
    for path in (video, calibration):
        path.write_bytes(b"")
    settings.cameras, settings.calibration = f"left=webcam:0 oak:14442C right='{video}'", str(calibration)
    with pytest.raises(RuntimeError, match="not started"):
        bpy.ops.mocap.live_start()
    [(arguments, _)] = asked
    cameras = ["left=webcam:0", "oak:14442C", f"right={video}"]
    assert arguments[0] == "live cameras"
    assert arguments[1][:7] == [*cameras, "--calibration", str(calibration), "--detector", "mediapipe"]
    assert arguments[1][-2] == "--record" and arguments[1][-1].endswith(".npz")


def test_a_face_is_recorded_as_a_table_and_shows_no_body(mocap, asked):
    mocap.live.kind, mocap.live.listen = "VMC", "livelink://"
    with pytest.raises(RuntimeError, match="not started"):
        bpy.ops.mocap.live_start()
    [(arguments, _)] = asked
    assert arguments[0] == "live stream" and arguments[1][:2] == ["livelink://127.0.0.1:11111", "--record"]
    assert arguments[1][2].endswith(".csv") and len(arguments[1]) == 3
    mocap.live.listen = "nonsense://"
    with pytest.raises(RuntimeError, match="not a sender address"):
        bpy.ops.mocap.live_start()
