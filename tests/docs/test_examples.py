"""The examples in the documentation run as they stand, on a short capture."""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import solver_backend
from solver_backend import demo_capture, read_motion, write_capture
from solver_backend.camera_calibration.formats import write_calibration
from solver_backend.cameras.camera_corrections import resized
from solver_backend.cameras.projection import project
from solver_backend.cli.main import main
from solver_backend.types import JointSet
from solver_backend.videos.detect.detect_videos import detect_videos
from solver_backend.videos.detect.detector import DetectorMissing, chosen_detector
from tests.support.short_solves import cut
from tests.support.videos import write_dots, write_timed_video

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "docs" / "examples"
FRAMES = 30
SIDE = 320  # Width and height of a filmed picture.


def run(name: str, *arguments: Path) -> str:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, str(EXAMPLES / name), *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("examples") / "capture.npz"
    write_capture(path, cut(demo_capture(), 0, FRAMES))
    return path


@pytest.fixture(scope="module")
def solved(capture: Path) -> tuple[Path, str]:
    path = capture.with_name("motion.npz")
    return path, run("solve_capture.py", capture, path)


def test_a_capture_is_solved_and_its_report_written(solved: tuple[Path, str]) -> None:
    path, said = solved
    assert read_motion(path).num_frames == FRAMES
    assert path.with_suffix(".html").is_file()
    assert f"{FRAMES} frames, " in said and "linearisations" in said


def test_a_range_is_solved_again_through_a_pin(capture: Path, solved: tuple[Path, str]) -> None:
    again = capture.with_name("again.npz")
    said = run("solve_range_again.py", capture, solved[0], again)
    before, after = read_motion(solved[0]), read_motion(again)
    outside = [*range(8), *range(21, FRAMES)]
    np.testing.assert_array_equal(after.joints[outside], before.joints[outside])
    assert after.body_pose[14, 52] == pytest.approx(before.body_pose[14, 52] - np.deg2rad(10), abs=1e-4)
    assert "moved" in said


@pytest.mark.slow
def test_a_prior_of_ones_own_is_used(capture: Path) -> None:
    said = run("own_prior.py", capture, capture.with_name("braced.npz"))
    assert float(said.split(" by ")[1].split()[0]) < 6.0
    assert read_motion(capture.with_name("braced.npz")).provenance["prior"]["name"] == "sposer_in_braces"


def test_a_motion_is_baked_without_a_window(capture: Path, solved: tuple[Path, str]) -> None:
    pytest.importorskip("bpy")
    said = run("bake_headless.py", solved[0], capture, capture.with_name("baked"))
    assert '"result"' in said
    assert list(capture.with_name("baked").glob("*.blend"))


def test_a_detector_of_ones_own_finds_what_is_in_the_video(tmp_path: Path) -> None:
    pytest.importorskip("av")
    times = np.arange(5) / 30.0
    dots = np.array([[30.0, 25.0], [120.0, 40.0], [80.0, 95.0]]) + np.arange(5)[:, None, None]
    video, worker = write_dots(tmp_path / "cam1.mp4", dots, times), EXAMPLES / "own_detector.py"
    [found] = detect_videos([video], chosen_detector(worker=worker), tmp_path / "kept")
    assert found.detector == "brightest 1.0" and found.joint_set is JointSet.COCO_17
    near = np.linalg.norm(found.xy[:, 0, :, None] - dots[:, None], axis=-1).min(axis=-1)
    assert near.max() < 8.0, "every keypoint is within a dot"
    own = tmp_path / "own.py"
    own.write_text(worker.read_text(encoding="utf-8").replace("brightest 1.0", "brightest 2.0"), encoding="utf-8")
    [again] = detect_videos([video], chosen_detector(worker=own), tmp_path / "kept")
    assert again.detector == "brightest 2.0", "a changed worker is asked again"
    with pytest.raises(DetectorMissing, match="finds no hands"):
        detect_videos([video], chosen_detector(worker=own, hands=True), tmp_path / "kept")
    with pytest.raises(DetectorMissing, match=r"There is no such worker"):
        chosen_detector(worker=tmp_path / "none.py")


@pytest.mark.slow
def test_a_model_of_ones_own_takes_videos_to_a_body(tmp_path: Path) -> None:
    for package in ("av", "onnx", "onnxruntime"):
        pytest.importorskip(package)
    run("own_model.py", tmp_path)
    page = (ROOT / "docs" / "how-to" / "add-a-detector.md").read_text(encoding="utf-8")
    shown = page.split("`own.json`", 1)[1].split("```json\n", 1)[1].split("```")[0]
    assert json.loads(shown) == json.loads((tmp_path / "own.json").read_text(encoding="utf-8"))
    truth = film_dots(tmp_path / "session", frames=60)
    command = ["from-videos", str(tmp_path / "session"), "--detector", str(tmp_path / "own.json"), "--sync", "none"]
    assert main(command) == 0
    motion = read_motion(tmp_path / "session" / "mocap" / "motion.npz")
    assert motion.num_frames >= 59  # whole milliseconds may end a video before the last moment
    off = np.linalg.norm(motion.joints[:, 1:10] - truth[: motion.num_frames, 1:10], axis=-1)
    assert np.median(off) < 0.03, np.median(off)


def film_dots(session: Path, frames: int) -> np.ndarray:
    """Write four videos of the demo's person as coloured dots, and a calibration. Return the (F, J, 3) true joints."""
    spec = importlib.util.spec_from_file_location("own_model", EXAMPLES / "own_model.py")
    assert spec is not None and spec.loader is not None
    spec.loader.exec_module(own_model := importlib.util.module_from_spec(spec))
    capture = demo_capture(frames)
    assert capture.cameras is not None
    columns = [JointSet.BODY_25.keypoints.index(name) for name in JointSet.COCO_17.keypoints]
    first, side = 420, 1080  # The square in the middle of 1920 x 1080 pixels.
    K, size = capture.cameras.K.copy(), np.full((4, 2), side)
    K[:, 0, 2] -= first
    cameras = replace(capture.cameras, K=K, image_size=size, distortion=np.zeros((4, 8)))
    for c in range(4):
        cameras = resized(cameras, c, (SIDE, SIDE))
    px = project(cameras, capture.truth["keypoints3d"][:, columns])
    (session / "videos").mkdir(parents=True)
    write_calibration(session / "calibration.toml", cameras)
    y, x = np.mgrid[:SIDE, :SIDE]
    for name, track in zip(cameras.names, px, strict=True):
        pictures = np.zeros((frames, SIDE, SIDE, 3), np.uint8)
        for picture, places in zip(pictures, track, strict=True):
            for colour, (u, v) in zip(own_model.COLOURS, places, strict=True):
                picture[np.hypot(x - u, y - v) < 5.0] = colour
        write_timed_video(session / "videos" / f"{name}.mp4", pictures, np.arange(frames) / 60.0)
    return capture.truth["joints"]


def test_every_example_is_run_here() -> None:
    own = Path(__file__).read_text(encoding="utf-8")
    assert all(f'"{path.name}"' in own for path in EXAMPLES.glob("*.py"))


def test_public_names_are_there_and_imported_only_when_asked_for() -> None:
    assert solver_backend.__all__ == sorted(solver_backend.__all__)
    assert all(getattr(solver_backend, name) is not None for name in solver_backend.__all__)
    with pytest.raises(AttributeError, match="solver_backend has no nonsense; it has AutoencodingPrior"):
        _ = solver_backend.nonsense
    code = "import sys, solver_backend as s; assert 'numpy' not in sys.modules; s.Motion; assert 'numpy' in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)
