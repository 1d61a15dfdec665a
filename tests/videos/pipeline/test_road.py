from __future__ import annotations

import json
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from solver_backend.cli.main import main
from solver_backend.exchange.diagnostics import Severity, diagnostic, read_diagnostics
from solver_backend.exchange.errors import BackendMissing, Cancelled, NoDetections, OutputExists, OutputNotWritable
from solver_backend.exchange.progress import silent
from solver_backend.types import JointSet
from solver_backend.videos.detect.detect_videos import Glance
from solver_backend.videos.detect.detector import chosen_detector
from solver_backend.videos.pipeline import run
from solver_backend.videos.pipeline.calibrate import CalibrationRequest, KnownOfCameras
from solver_backend.videos.pipeline.layout import CalibrationFootage, NoVideos, look_through
from solver_backend.videos.pipeline.plan import PipelineSettings, Records, planned
from solver_backend.videos.pipeline.run import run_take
from solver_backend.videos.sync.clocks import Clocks
from solver_backend.videos.video_detections import VideoDetections
from tests.support.pose_models import write_rtmpose
from tests.support.videos import write_dots

TRIAL = "multiview/pose2sim/S00_P00_SingleParticipant"


def touched(*paths: Path) -> None:
    for path in paths:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()


def test_folders_of_several_programs_are_understood(tmp_path: Path) -> None:
    pose2sim = tmp_path / "pose2sim"
    touched(*(pose2sim / "S00" / "T01" / "videos" / f"cam{c:02d}.mp4" for c in (1, 2, 10)))
    touched(*(pose2sim / "S00" / "T01" / "pose" / f"cam{c:02d}_json" / "a.json" for c in (1, 2)))
    touched(*(pose2sim / "calibration" / "intrinsics" / f"int_cam{c:02d}_img" / "1.jpg" for c in (1, 2)))
    touched(*(pose2sim / "calibration" / "extrinsics" / f"ext_cam{c:02d}.mp4" for c in (1, 2)))
    found = look_through(pose2sim)
    assert [take.cameras for take in found.takes] == [("cam01", "cam02", "cam10")] and found.takes[0].name == "T01"
    assert {(f.kind, tuple(f.cameras)) for f in found.footage} == {
        ("intrinsics", ("cam01", "cam02")), ("extrinsics", ("cam01", "cam02")),
    }  # fmt: skip
    freemocap = tmp_path / "freemocap" / "session"
    touched(*(freemocap / "recording_1" / "synchronized_videos" / f"Camera_00{c}.mp4" for c in (0, 1)))
    touched(*(freemocap / "recording_1" / "annotated_videos" / f"Camera_00{c}_annotated.mp4" for c in (0, 1)))
    assert [take.name for take in look_through(freemocap).takes] == ["recording_1"]
    touched(*(tmp_path / "flat" / name for name in ("left.mov", "right.MP4", "notes.txt")))
    assert look_through(tmp_path / "flat").takes[0].cameras == ("left", "right")
    assert look_through(freemocap / "recording_1" / "synchronized_videos").takes[0].name == "recording_1"


def test_a_folder_without_takes_has_a_name(tmp_path: Path) -> None:
    (tmp_path / "none").mkdir()
    with pytest.raises(NoVideos, match="not contain a take"):
        look_through(tmp_path / "none")
    touched(tmp_path / "one" / "videos" / "cam1.mp4")
    [take] = look_through(tmp_path / "one").takes
    assert (take.name, take.cameras) == ("one", ("cam1",))
    video = tmp_path / "one" / "videos" / "cam1.mp4"
    [take] = look_through(video).takes
    assert (take.name, take.videos, take.cameras) == ("cam1", (video,), ("cam1",))
    with pytest.raises(NoVideos, match="no such folder"):
        look_through(tmp_path / "absent")


def test_the_plan_of_a_recorded_session(shared_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = look_through(shared_data / TRIAL)
    assert [take.name for take in found.takes] == ["S00_P00_T00_StaticTrial", "S00_P00_T01_BalancingTrial"]
    assert sorted((f.kind, len(f.cameras)) for f in found.footage) == [("extrinsics", 4), ("intrinsics", 4)]
    worker = tmp_path / "worker.py"
    worker.touch()
    words = ["--out", str(tmp_path / "out"), "--detector-worker", str(worker), "--dry-run"]
    assert main(["from-videos", str(shared_data / TRIAL), *words]) == 0
    assert "kept: Calib.qca.txt, 4 cameras" in capsys.readouterr().out and not (tmp_path / "out").exists()


def test_records_know_what_was_made_of_what(tmp_path: Path) -> None:
    out = tmp_path / "out.npz"
    records = Records(tmp_path)
    assert not records.is_made(out, [1]) and not records.is_ours(out)
    out.touch()
    records.made(out, [1, {"a": None}])
    again = Records(tmp_path)
    assert again.is_made(out, [1, {"a": None}]) and again.is_ours(out) and not again.is_made(out, [2])
    out.unlink()
    assert not again.is_made(out, [1, {"a": None}])


def test_what_a_killed_run_was_making_is_ours_and_what_failed_is_not(tmp_path: Path) -> None:
    out, records = tmp_path / "sync.json", Records(tmp_path)
    with suppress(ZeroDivisionError), records.making(out):
        raise ZeroDivisionError
    assert not Records(tmp_path).is_ours(out)
    with records.making(out):
        out.touch()
        killed = Records(tmp_path)  # as the next run finds it
        assert killed.is_ours(out) and not killed.is_made(out, "")
    records.made(out, [1])
    assert Records(tmp_path).is_made(out, [1])


@pytest.fixture
def session(tmp_path: Path) -> Path:
    """Return a folder with a take of two cameras and nothing else."""
    pytest.importorskip("av")
    pytest.importorskip("onnxruntime")
    folder = tmp_path / "session" / "videos"
    folder.mkdir(parents=True)
    rng = np.random.default_rng(0)
    for camera in (1, 2):
        path = np.array([[30.0, 25.0], [120.0, 40.0], [80.0, 95.0]]) + np.cumsum(rng.normal(0, 1, (15, 3, 2)), axis=0)
        write_dots(folder / f"cam{camera}.mp4", path, np.arange(15) / 30.0)
    return folder.parent


def settings(tmp_path: Path, **more) -> PipelineSettings:
    return PipelineSettings(chosen_detector(str(write_rtmpose(tmp_path / "m.onnx"))), sync="none", **more)


def test_one_camera_is_in_sync_with_nobody(session: Path, tmp_path: Path) -> None:
    (session / "videos" / "cam2.mp4").unlink()
    found, out = look_through(session), tmp_path / "out"
    [plan] = planned(found, out)
    run_take(found, plan, settings(tmp_path, until="sync"))
    _, clocks = json.loads((out / "road.json").read_text(encoding="utf-8"))["steps"]
    assert clocks["step"] == "sync" and clocks["diagnostics"] == []


def test_cameras_are_calibrated_where_no_calibration_is(
    session: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found, out = look_through(session), tmp_path / "out"
    [plan] = planned(found, out)
    with pytest.raises(NoDetections, match="Only 15 frames show the person to two cameras, but 30 are needed"):
        run_take(found, plan, settings(tmp_path))
    left = ["detections", "pictures", "road.json", "steps.json", "sync.json"]
    assert sorted(path.name for path in out.iterdir()) == left
    kept = json.loads((out / "road.json").read_text(encoding="utf-8"))
    assert kept["version"] == 2 and [step["step"] for step in kept["steps"]] == ["detect", "sync"]
    assert all((out / picture).is_file() for step in kept["steps"] for picture in step["pictures"])
    searched, clocks = (read_diagnostics(step["diagnostics"]) for step in kept["steps"])
    assert searched[0].code == "videos_searched" and searched[0].values["count"] == 30
    assert [item.code for item in clocks][:1] == ["clocks_assumed"]
    asked: list[CalibrationRequest] = []

    def calibrated(request: CalibrationRequest, known: KnownOfCameras, progress: object) -> tuple:
        asked.append(request)
        assert known.stature_m == 1.7
        cameras = [
            f'[cam_{c}]\nname = "cam{c}"\nsize = [160, 120]\nmatrix = [[150, 0, 80], [0, 150, 60], [0, 0, 1]]\n'
            f"distortions = [0, 0, 0, 0]\nrotation = [1.5707963, 0, 0]\ntranslation = [{0.4 * c}, 0, 3]\n"
            for c in (1, 2)
        ]
        request.out.write_text("\n".join(cameras), encoding="utf-8")
        made = diagnostic("cameras_calibrated", count=2, method="person", size=1.0)
        guess = {"severity": Severity.WARNING, "size": 900.0, "share": 15.0, "source": "a guess"}
        return "person", (made, diagnostic("focal_length_of_video", cameras=["cam1"], **guess))

    monkeypatch.setattr(run, "calibrate_take", calibrated)
    chosen = settings(tmp_path, until="calibrate", cameras=KnownOfCameras(stature_m=1.7))
    said = run_take(found, plan, chosen).lines()
    assert said["calibrate"].startswith(
        "made: 2 cameras were calibrated from the person, with an error of 1.0 px. cam1: the focal"
    )
    assert asked[0].clocks.names == ("cam1", "cam2")
    assert len(asked[0].detections) == 2 and asked[0].take.name == "session"
    said = run_take(found, plan, chosen).lines()
    assert said["calibrate"].startswith("kept") and said["sync"].startswith("kept") and len(asked) == 1
    assert said["detect"].startswith("kept: Keypoints were detected in 30 images")
    (next((out / "detections").glob("cam2*"))).unlink()
    assert run_take(found, plan, chosen).lines()["detect"].startswith("made: Keypoints were detected in 30 images")
    run_take(found, plan, replace(chosen, redo=("calibrate",)))
    assert len(asked) == 2
    run_take(found, plan, replace(chosen, cameras=replace(chosen.cameras, source="person")))
    assert len(asked) == 2  # the person told it already
    run_take(found, plan, replace(chosen, cameras=replace(chosen.cameras, source="board")))
    assert len(asked) == 3


def test_the_last_line_names_what_to_look_at(
    session: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def found_by(detections: Sequence[VideoDetections], *_: object) -> Clocks:
        clocks = Clocks.alike(tuple(item.name for item in detections))
        return replace(clocks, findings=(diagnostic("clocks_assumed", reason="nobody moves"),))

    command = ["from-videos", str(session), "--detector", str(write_rtmpose(tmp_path / "m.onnx")), "--until", "sync"]
    command += ["--sync", "none", "--out"]
    assert main([*command, str(tmp_path / "fine")]) == 0
    assert capsys.readouterr().err.splitlines()[-1] == "OK"
    monkeypatch.setattr(run, "synchronise", found_by)
    assert main([*command, str(tmp_path / "doubtful")]) == 0
    *_, warned, last = capsys.readouterr().err.splitlines()
    assert warned.startswith("warning: The cameras are assumed to be synchronised: nobody moves") and last.startswith(
        "Look at "
    )


def test_somebody_elses_file_stays(session: Path, tmp_path: Path) -> None:
    found, out = look_through(session), tmp_path / "out"
    touched(out / "sync.json")
    [plan] = planned(found, out)
    with pytest.raises(OutputExists, match="did not write"):
        run_take(found, plan, settings(tmp_path))
    assert (out / "sync.json").read_bytes() == b""


def test_the_verb_says_what_is_there(session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model = write_rtmpose(tmp_path / "m.onnx")
    command = ["from-videos", str(session), "--out", str(tmp_path / "out"), "--detector", str(model), "--json"]
    assert main([*command, "--until", "sync", "--sync", "none"]) == 0
    result = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert result["takes"]["session"]["detect"] == "made: Keypoints were detected in 30 images with RTMPose m."
    assert main([*command, "--take", "other"]) == 2
    assert "The takes are session" in capsys.readouterr().out


def test_convert_takes_a_folder_of_videos_down_the_road(
    session: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    chosen = settings(tmp_path).detector
    monkeypatch.setattr("solver_backend.videos.detect.detector.chosen_detector", lambda: chosen)
    out = tmp_path / "demo" / "capture.npz"
    assert main(["convert", str(session), "--out", str(out)]) == 3
    assert "30 are needed" in capsys.readouterr().err and not out.exists()
    touched(tmp_path / "empty" / "notes.txt")
    assert main(["convert", str(tmp_path / "empty"), "--out", str(out)]) == 3
    assert "contains no supported detections" in capsys.readouterr().err


def test_a_preview_ends_no_detection_and_is_never_the_result(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    video, joints = tmp_path / "v.mp4", JointSet.COCO_17
    glance = Glance(video, np.zeros((48, 64, 3), np.uint8), np.zeros((0, 17, 3)), joints)
    xy, sure, track = np.full((3, 1, 17, 2), 5.0), np.ones((3, 1, 17)), np.zeros((3, 1), int)

    def detect(name: str, *, stopped: bool) -> bytes:
        def detect_videos(*_: object, show: Callable[[list[Glance]], object], **__: object) -> list[VideoDetections]:
            if stopped:
                show([glance])
                raise Cancelled("The work was cancelled.")
            return [VideoDetections(video, "hash", name, joints, (64, 48), np.arange(3) / 30.0, xy, sure, track)]

        def final(found: Sequence[VideoDetections], path: Path) -> None:
            path.parent.mkdir(exist_ok=True)
            path.write_text(found[0].detector)

        monkeypatch.setattr(run, "detect_videos", detect_videos)
        monkeypatch.setattr(run.pictures, "detections_picture", final)
        take = SimpleNamespace(videos=(video,), cameras=("v",), name="t")
        told: Any = SimpleNamespace(jobs=0, detector=None, redo=(), pictures_fps=30.0, until="solve")
        plan: Any = SimpleNamespace(folder=tmp_path, take=take)
        with suppress(Cancelled):
            run._TakeRun(cast(Any, None), plan, told, silent).detect()
        return (tmp_path / "pictures/detect.png").read_bytes()

    assert detect("A", stopped=False) == b"A"
    assert detect("B", stopped=True) != b"A", "a preview"
    assert detect("A", stopped=False) == b"A"

    def unwritable(*_: object, **__: object) -> None:
        raise OutputNotWritable("Another program has it open.")

    monkeypatch.setattr(run.pictures, "glances_picture", unwritable)
    assert detect("A", stopped=True) == b"A"


def test_a_board_that_cannot_be_found_is_named_before_detection(
    session: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def missing() -> None:
        raise BackendMissing("This step needs OpenCV, which is not installed.")

    monkeypatch.setattr(run, "opencv", missing)
    monkeypatch.setattr(run, "detect_videos", None)
    found = look_through(session)
    [plan] = planned(found, tmp_path / "out")
    filmed = replace(found, footage=(CalibrationFootage("both", session, {}),))
    with pytest.raises(BackendMissing):
        run_take(filmed, plan, settings(tmp_path))
    monkeypatch.undo()
    run_take(filmed, plan, settings(tmp_path, until="sync"))


@pytest.mark.parametrize(
    ("kind", "words", "said"),
    [("extrinsics", [], "cameras from the board"), ("intrinsics", [], "lenses from the board"),
     ("extrinsics", ["--cameras", "person"], ""), ("intrinsics", ["--lenses", "calibration.toml"], ""),
     ("intrinsics", ["--cameras", "person", "--board", "charuco:5x7:35mm"], "lenses from the board")],
)  # fmt: skip
def test_a_dry_run_names_an_opencv_that_is_missing_where_a_board_is_used(
    session: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
    kind: str, words: list[str], said: str,
) -> None:  # fmt: skip
    monkeypatch.setitem(sys.modules, "cv2", None)
    for name in ("cam01", "cam02"):
        touched(session / kind / f"{name}.mp4")
    worker = tmp_path / "worker.py"
    worker.touch()
    assert main(["from-videos", str(session), "--detector-worker", str(worker), "--dry-run", *words]) == 0
    [line] = [line for line in capsys.readouterr().out.splitlines() if " calibrate " in line]
    assert ("needs OpenCV" in line) is bool(said) and (said or "cameras from the person alone") in line
    assert ("pip install" in line) is bool(said)
