"""Captures from videos by the operators, with the solver's and a detector's real processes, without a window."""

from __future__ import annotations

import json
from itertools import islice
from pathlib import Path
from types import SimpleNamespace

import bpy
import numpy as np
import pytest

from blender_addon.solving.take_paths import read_road
from blender_addon.ui.operators.base import SolverOperator, current
from blender_addon.ui.panels.videos import Previews
from solver_backend.exchange.diagnostics import diagnostic, sentence
from solver_backend.videos.detect.detector import DetectorMissing, chosen_detector
from solver_backend.videos.files.video import probe, read_pictures
from solver_backend.videos.pipeline.plan import Steps
from tests.support.pose_models import write_rtmpose
from tests.support.videos import write_dots, write_timed_video

TRIAL = "multiview/pose2sim/S00_P00_SingleParticipant/S00_P00_T01_BalancingTrial"
CALIBRATION = "multiview/pose2sim/S00_Calibration/Calib.qca.txt"
PICTURES = 8


@pytest.fixture
def take(tmp_path: Path) -> Path:
    """Return a folder with a take of two cameras in which three dots move, and nothing else."""
    pytest.importorskip("av")
    pytest.importorskip("onnxruntime")
    pytest.importorskip("cv2")
    folder = tmp_path / "Aufnahme ü" / "videos"
    folder.mkdir(parents=True)
    rng = np.random.default_rng(0)
    for camera in (1, 2):
        path = np.array([[30.0, 25.0], [120.0, 40.0], [80.0, 95.0]]) + np.cumsum(rng.normal(0, 1, (12, 3, 2)), axis=0)
        write_dots(folder / f"cam{camera}.mp4", path, np.arange(12) / 30.0)
    return folder.parent


def by_model(mocap: bpy.types.PropertyGroup, model: Path) -> None:
    mocap.videos.detector, mocap.videos.model, mocap.videos.clocks = "model", str(write_rtmpose(model)), "none"


def test_a_road_that_ends_early_shows_what_was_done_and_why_it_ended(mocap, take, tmp_path):
    by_model(mocap, tmp_path / "m.onnx")
    assert bpy.ops.mocap.capture_from_videos(directory=str(take)) == {"FINISHED"}
    assert current.last.error["code"] == "no_detections" and "30 are needed" in current.last.error["message"]
    steps = {step.name: step for step in mocap.videos.steps}
    assert list(steps) == ["detect", "sync"] and "24 images with RTMPose" in steps["detect"].notes
    for step in steps.values():
        assert [Path(picture.name).parent for picture in step.pictures] == [take / "mocap" / "pictures"]
    assert not mocap.captures


@pytest.mark.slow
def test_one_step_is_done_again_alone(mocap, take, tmp_path, monkeypatch):
    by_model(mocap, tmp_path / "m.onnx")
    bpy.ops.mocap.capture_from_videos(directory=str(take))
    asked: list[list[str]] = []
    real = SolverOperator.launch

    def launch(self, context, verb, arguments, folder):
        asked.append([verb, *arguments])
        return real(self, context, verb, arguments, folder)

    monkeypatch.setattr(SolverOperator, "launch", launch)
    before = {path: path.stat().st_mtime_ns for path in (take / "mocap" / "detections").iterdir()}
    mocap.videos.steps[1].open = True
    assert bpy.ops.mocap.video_step(step="detect") == {"FINISHED"}
    command = " ".join(asked[0])
    assert command.startswith("from-videos") and "--until detect" in command and command.endswith("--redo detect")
    after = {path: path.stat().st_mtime_ns for path in (take / "mocap" / "detections").iterdir()}
    assert before.keys() == after.keys() and all(after[path] > before[path] for path in before)
    assert bpy.ops.mocap.video_step(step="sync") == {"FINISHED"}
    assert [step.name for step in mocap.videos.steps] == ["detect", "sync"]
    assert "--redo" not in " ".join(asked[1])  # the run before ended before it


def test_a_dropped_video_stands_for_its_folder(mocap, take, monkeypatch):
    asked: list[list[str]] = []
    monkeypatch.setattr(SolverOperator, "launch", lambda self, c, verb, a, f: asked.append([verb, *a]) or {"FINISHED"})
    mocap.videos.cameras, mocap.videos.stature = "person", 1.72
    bpy.ops.mocap.capture_from_videos(directory=str(take / "videos"), files=[{"name": "cam1.mp4"}])
    command = " ".join(asked[0])
    assert asked[0][:2] == ["from-videos", str(take / "videos")]
    assert "--cameras person" in command and "--stature 1.7200" in command and "--until capture" in command
    assert Path(mocap.videos.results) == take / "videos" / "mocap"


def test_one_video_of_many_is_solved_alone(mocap, take, monkeypatch):
    asked: list[list[str]] = []
    monkeypatch.setattr(SolverOperator, "launch", lambda self, c, verb, a, f: asked.append([verb, *a]) or {"FINISHED"})
    chosen = {"directory": str(take / "videos"), "files": [{"name": "cam2.mp4"}], "one_camera": True}
    bpy.ops.mocap.capture_from_videos(**chosen)
    assert asked[0][:2] == ["from-videos", str(take / "videos" / "cam2.mp4")]
    assert Path(mocap.videos.results) == take / "videos" / "cam2_mocap"
    with pytest.raises(RuntimeError, match="No video is chosen"):
        bpy.ops.mocap.capture_from_videos(directory=str(take / "videos"), one_camera=True)


@pytest.mark.slow
def test_a_video_becomes_an_animation_in_three_clicks(mocap, shared_data, tmp_path):
    """The tab, *Capture from Videos*, *Solve*; choosing the file does not count."""
    pytest.importorskip("av")
    pytest.importorskip("cv2")
    try:
        chosen_detector()
    except DetectorMissing as missing:
        pytest.skip(str(missing))
    source = probe(shared_data / TRIAL / "videos" / "cam01.mp4")
    pictures = [p.rgb[::2, ::2] for p in islice(read_pictures(source), 40)]
    write_timed_video(tmp_path / "walk.mp4", pictures, np.arange(40) / source.fps)
    assert bpy.ops.mocap.capture_from_videos(filepath=str(tmp_path / "walk.mp4")) == {"FINISHED"}, current.last.error
    assert bpy.ops.mocap.solve.poll() and bpy.ops.mocap.solve() == {"FINISHED"}, current.last.error
    assert mocap.review.take["frames"] == 40 and mocap.review.armature.animation_data.action is not None


def test_results_go_elsewhere_where_the_videos_folder_cannot_be_written_to(mocap, take, tmp_path, monkeypatch):
    asked: list[list[str]] = []
    monkeypatch.setattr(SolverOperator, "launch", lambda self, c, verb, a, f: asked.append(a) or {"FINISHED"})
    (take / "mocap").write_text("somebody's file")
    bpy.ops.mocap.capture_from_videos(directory=str(take))
    assert Path(asked[0][asked[0].index("--out") + 1]).is_relative_to(tmp_path / "Aufnahmen ü")


@pytest.mark.slow
def test_recorded_videos_become_a_capture_that_is_ready_to_solve(mocap, shared_data, tmp_path):
    pytest.importorskip("av")
    pytest.importorskip("cv2")
    try:
        chosen_detector()
    except DetectorMissing as missing:
        pytest.skip(str(missing))
    folder = tmp_path / "session" / "videos"
    folder.mkdir(parents=True)
    for camera in range(1, 5):
        source = probe(shared_data / TRIAL / "videos" / f"cam0{camera}.mp4")
        pictures = [p.rgb[::2, ::2] for p in islice(read_pictures(source), PICTURES)]
        write_timed_video(folder / source.path.name, pictures, np.arange(PICTURES) / source.fps)
    (folder.parent / "calibration").mkdir()
    (folder.parent / "calibration" / "Calib.qca.txt").write_bytes((shared_data / CALIBRATION).read_bytes())
    mocap.videos.clocks = "none"
    assert bpy.ops.mocap.capture_from_videos(directory=str(folder.parent)) == {"FINISHED"}, current.last.error
    capture = mocap.capture
    assert (capture.frames, len(capture.cameras), capture.joint_set) == (PICTURES, 4, "MEDIAPIPE_33")
    assert all(item.object.type == "CAMERA" and item.has_footage for item in capture.cameras)
    assert [step.name for step in mocap.videos.steps] == ["detect", "sync", "calibrate", "capture"]
    assert mocap.videos.steps[-1].pictures[0].name.endswith("cameras.png")
    assert bpy.ops.mocap.solve.poll()
    assert bpy.ops.mocap.video_step(step="capture") == {"FINISHED"}
    assert len(mocap.captures) == 1  # in its own place


def test_what_a_file_of_steps_says_is_not_trusted(tmp_path):
    (tmp_path / "results").mkdir()
    (tmp_path / "secret.png").write_bytes(b"x")
    (tmp_path / "results" / "mine.png").write_bytes(b"x")
    fine = {"code": "scene_message", "values": {"text": "fine\u202e"}}
    said = {
        "format": "manifold_mocap_road", "version": 2,
        "steps": [
            {"step": "detect", "state": "made", "diagnostics": [3, fine],
             "pictures": ["../secret.png", "mine.png", "gone.png", 7, str(tmp_path / "secret.png")]},
            "nonsense",
        ],
    }  # fmt: skip
    file = tmp_path / "results" / "road.json"
    file.write_text(json.dumps(said), encoding="utf-8")
    [step] = read_road(file.parent)
    assert step.pictures == ((tmp_path / "results" / "mine.png").resolve(),)
    assert [(item.code, sentence(item)) for item in step.diagnostics] == [("scene_message", "fine\ufffd.")]
    for broken in ("{", "[]", json.dumps({**said, "version": 3}), json.dumps({**said, "steps": 5})):
        file.write_text(broken, encoding="utf-8")
        assert read_road(file.parent) == ()
    assert read_road(tmp_path / "absent") == ()


def test_steps_hold_diagnostics(tmp_path):
    steps = Steps(tmp_path, "walk")
    found = [diagnostic("videos_searched", count=40, detector="RTMPose"), diagnostic("rolling_shutter")]
    steps.report("detect", "made", found)
    [step] = read_road(tmp_path)
    assert [(item.code, item.severity, item.values) for item in step.diagnostics] == [
        (item.code, item.severity, item.values) for item in found
    ]


def test_a_picture_is_loaded_again_when_its_file_changes(tmp_path):
    from solver_backend.camera_calibration.pictures import Canvas

    pytest.importorskip("cv2")
    path = Canvas(64, 64).save(tmp_path / "picture.png")
    shown = Previews()
    assert shown.icon(path) == 0 and not shown.loaded  # not registered
    shown.start()
    try:
        shown.icon(path)  # without a window every icon is 0
        first = shown.loaded
        shown.icon(path)
        assert len(first) == 1 and shown.loaded == first
        Canvas(32, 32).save(path)
        shown.icon(path)
        assert len(shown.loaded) == 1 and shown.loaded != first
        assert shown.icon(tmp_path / "absent.png") == 0
    finally:
        shown.stop()


class Layout:
    """Takes down what a panel draws."""

    drawn: list[tuple[str, str]]

    def __init__(self) -> None:
        object.__setattr__(self, "drawn", [])

    def __setattr__(self, name: str, value: object) -> None:
        """Take every setting."""

    def __getattr__(self, name: str):
        def draw(*args, **given):
            if name not in ("row", "column", "box"):
                self.drawn.append((name, given.get("text") or (args[0] if name == "operator" else "")))
            return self

        return draw


def test_the_panel_shows_steps_that_are_done_and_offers_the_others(mocap, tmp_path):
    context = SimpleNamespace(
        scene=bpy.context.scene,
        region=SimpleNamespace(width=400),
        preferences=SimpleNamespace(system=SimpleNamespace(ui_scale=1.0), addons={}),
    )
    unsure = diagnostic("person_seldom_found", file="cam2.mp4", share=60.0)
    steps = Steps(tmp_path, "walk")
    steps.report("detect", "made", [diagnostic("videos_searched", count=40, detector="RTMPose"), unsure])
    mocap.videos.folder = str(tmp_path)
    mocap.videos.take_steps(str(tmp_path))
    drawn = []
    for opened in (False, True):
        mocap.videos.steps[0].open = opened
        layout = Layout()
        bpy.types.VIEW3D_PT_mocap_videos.draw(SimpleNamespace(layout=layout), context)
        drawn.append(layout.drawn)
        assert sum(call == ("operator", "mocap.video_step") for call in layout.drawn) == 4
        assert [said for name, said in layout.drawn if said in ("Keypoints", "Sync", "Calibration", "Capture")]
    words = [" ".join(said for name, said in layout if name == "label") for layout in drawn]
    assert "cam2.mp4" not in words[0]
    assert (
        "No person was detected in 60 % of the images from cam2.mp4" in words[1]
        and "40 images with RTMPose." in words[1]
    )
    assert all("--stature" not in word for word in mocap.videos.arguments())
