"""Folders whose cameras started apart or are numbered differently, read as one take."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from research.simulation.benchmark import BenchmarkSettings, benchmark_capture
from solver_backend.exchange.diagnostics import Remedy
from solver_backend.exchange.errors import FrameCountMismatch, JobInvalid, NotSynchronised
from solver_backend.io.captures.agreement import InTime, bring_to_one_time
from solver_backend.io.load import load_capture
from solver_backend.io.native.capture_file import write_capture
from solver_backend.io.reader import ReadOptions
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.types import Capture, Detections
from tests.support.calibration_files import toml_text
from tests.support.trial_files import frame_text
from tests.support.walking_take import walk
from tests.support.words import words

LENGTH = 200
STARTS = (0, 45, 90, 20)


@pytest.fixture(scope="module")
def demo() -> Capture:
    return demo_capture()


def write_apart(
    root: Path, capture: Capture, starts: tuple[int, ...], *, lengths: tuple[int, ...] = (LENGTH,) * 4,
    numbers: tuple[int, ...] = (0, 0, 0, 0),
) -> Path:  # fmt: skip
    """Write what cameras recorded that started at these frames, numbered from these numbers."""
    cameras, keypoints = capture.require_multiview()
    (root / "calibration").mkdir(parents=True)
    (root / "calibration" / "Calib.toml").write_text(toml_text(cameras))
    for c, name in enumerate(cameras.names):
        folder = root / "pose" / f"{name}_json"
        folder.mkdir(parents=True)
        for row in range(lengths[c]):
            f = starts[c] + row
            person = np.concatenate([keypoints.xy[c, f], keypoints.confidence[c, f][:, None]], axis=1)
            (folder / f"{name}_{row + numbers[c]:012d}_keypoints.json").write_text(frame_text([person]))
    return root


def error_m(capture: Capture, demo: Capture, first: int) -> float:
    """Return how far triangulated points are from the truth, the capture beginning at this frame of the demo."""
    from solver_backend.cameras.robust_triangulation import triangulate

    cameras, keypoints = capture.require_multiview()
    points = triangulate(cameras, keypoints.xy, keypoints.confidence).points
    truth = demo.truth["keypoints3d"][first : first + capture.num_frames]
    return float(np.nanmedian(np.linalg.norm(points - truth, axis=-1)))


def read(path: Path, **options: Any) -> Capture:
    return load_capture(path, fps=60.0, **options)


@pytest.mark.slow
def test_cameras_started_by_hand_are_brought_together_and_it_is_reported(tmp_path, demo):
    capture = read(write_apart(tmp_path / "take", demo, STARTS))
    assert capture.num_frames == LENGTH - 90
    assert error_m(capture, demo, 90) < 0.02
    [found] = [item for item in capture.problems if item.code == "starts_apart"]
    late = dict(zip(found.where.cameras, found.values["late"], strict=True))
    assert late == {"cam02": 45, "cam03": 90, "cam04": 20} and found.values["reference"] == "cam01"
    assert found.remedy is Remedy.REPAIRED
    [problem] = words([found])
    assert "did not start together" in problem
    assert "cam02 45 frames later" in problem and "--sync off" in problem


@pytest.mark.slow
def test_off_keeps_them_as_recorded(tmp_path, demo):
    capture = read(write_apart(tmp_path / "take", demo, STARTS), sync="off")
    assert capture.num_frames == LENGTH and not any("start together" in p for p in words(capture.problems))


@pytest.mark.slow
def test_given_offsets_bind(tmp_path, demo):
    root = write_apart(tmp_path / "take", demo, STARTS)
    capture = read(root, offset=("cam2=45", "cam03=90", "cam_04=20"))
    assert capture.num_frames == LENGTH - 90 and error_m(capture, demo, 90) < 0.02
    assert "cam02 starts 45 frames later, as requested." in words(capture.notes)
    with pytest.raises(JobInvalid, match="Unknown camera 'cam9'"):
        read(root, offset=("cam9=4",))
    with pytest.raises(JobInvalid, match="'cam02=half' is not CAMERA=FRAMES"):
        read(root, offset=("cam02=half",))


@pytest.mark.slow
def test_other_numbers_and_lengths_are_no_obstacle_where_the_views_tell(tmp_path, demo):
    root = write_apart(
        tmp_path / "take", demo, STARTS, lengths=(200, 190, 200, 180), numbers=(0, 7000, 1, 100000)
    )  # fmt: skip
    capture = read(root)
    assert error_m(capture, demo, 90) < 0.02
    with pytest.raises(FrameCountMismatch, match=r"no frame number in common.*--by-order"):
        read(root, sync="off")


@pytest.mark.slow
def test_by_order_counts_from_each_cameras_first(tmp_path, demo):
    root = write_apart(tmp_path / "take", demo, (0, 0, 0, 0), numbers=(0, 1, 500, 1000))
    capture = read(root, sync="off", by_order=True)
    assert capture.num_frames == LENGTH and error_m(capture, demo, 0) < 0.02


@pytest.mark.slow
def test_numbers_that_agree_are_kept_where_a_camera_has_fewer(tmp_path, demo):
    root = write_apart(tmp_path / "take", demo, (0, 0, 5, 0), lengths=(200, 198, 195, 200), numbers=(0, 0, 5, 0))
    capture = read(root)
    assert capture.num_frames == 193 and error_m(capture, demo, 5) < 0.02


def test_required_synchronisation_is_refused_where_nothing_moves(tmp_path, demo):
    _, keypoints = demo.require_multiview()
    first = (a[:, :1].repeat(360, 1) for a in (keypoints.xy, keypoints.confidence))
    held = replace(keypoints, **dict(zip(("xy", "confidence"), first, strict=True)))
    root = write_apart(tmp_path / "take", replace(demo, keypoints=held), STARTS)
    with pytest.raises(NotSynchronised, match="could not be estimated"):
        read(root, sync="on")
    assert any("could not be estimated" in note for note in words(read(root).notes))


def read_rows(capture: Capture, starts: tuple[int, ...], length: int, **options: Any) -> InTime:
    """Bring what cameras recorded that started at these frames to one time."""
    cameras, keypoints = capture.require_multiview()
    rows = [np.arange(start, start + length) for start in starts]
    xy, confidence = (
        np.stack([view[row] for view, row in zip(values, rows, strict=True)])[:, :, None]
        for values in (keypoints.xy, keypoints.confidence)
    )
    detections = Detections(cameras.names, xy, confidence, keypoints.joint_set)
    return bring_to_one_time(cameras, detections, keypoints.fps, ReadOptions(**options))


@pytest.mark.slow
def test_movement_that_repeats_is_a_problem_with_both_offsets():
    take = walk(500)
    in_place = benchmark_capture(replace(take, root=take.root * [1.0, 1.0, 0.0]), BenchmarkSettings(seed=1))
    found = read_rows(in_place, (0, 45, 0, 0), 400)
    [problem] = found.found
    assert problem.code == "start_ambiguous" and not found.first_rows
    assert problem.where.cameras == (in_place.cameras.names[1], in_place.cameras.names[0])
    one, other = problem.values["one"], problem.values["other"]
    assert {(one - 45) % 60, (other - 45) % 60} <= {0, 1, 59}, "45 frames late, or whole periods of the walk from there"
    assert f"offset by {one:+d} or {other:+d} frames from" in words([problem])[0]
    with pytest.raises(NotSynchronised, match="may not have started together"):
        read_rows(in_place, (0, 45, 0, 0), 400, sync="on")


def test_a_camera_that_shows_too_little_is_left_out_where_the_others_are_moved(demo):
    _, keypoints = demo.require_multiview()
    confidence = keypoints.confidence.copy()
    confidence[3, :100] = confidence[3, 110:] = 0.0
    found = read_rows(replace(demo, keypoints=replace(keypoints, confidence=confidence)), (0, 45, 90, 0), 200)
    moved, left_out, kept = found.found
    assert (moved.code, left_out.code) == ("starts_apart", "start_left_out")
    assert left_out.where.cameras == ("cam04",) and left_out.remedy is Remedy.EXCLUDED
    assert moved.where.cameras == ("cam02", "cam03") and moved.values["late"] == pytest.approx([45, 90], abs=1)
    assert (kept.code, kept.values["rows"]) == ("take_in_common", list(found.first_rows))
    assert kept.values["count"] == found.detections.num_frames and not found.detections.confidence[3].any()


@pytest.mark.slow
def test_a_synchronous_take_is_not_touched(tmp_path, demo):
    root = write_apart(tmp_path / "take", demo, (0, 0, 0, 0))
    one, other = read(root), read(root, sync="off")
    np.testing.assert_array_equal(one.keypoints.xy, other.keypoints.xy)
    assert (one.notes, one.problems) == (other.notes, other.problems)


def test_capture_files_too_with_truth_and_footage(tmp_path, demo):
    cameras, keypoints = demo.require_multiview()
    late = np.stack([np.roll(view, -start, axis=0) for view, start in zip(keypoints.xy, STARTS, strict=True)])
    path = write_capture(tmp_path / "take.npz", replace(
        demo, keypoints=replace(keypoints, xy=late), footage=tuple(Path(f"{name}.mp4") for name in cameras.names)
    ))  # fmt: skip
    capture = load_capture(path)
    assert capture.truth["joints"].shape[0] == capture.num_frames
    assert capture.footage_first == (90, 45, 0, 70)
    assert error_m(capture, demo, 90) < 0.02


@pytest.mark.slow
def test_frames_of_a_take(tmp_path, demo):
    root = write_apart(tmp_path / "take", demo, (0, 0, 0, 0))
    capture = read(root, frames=(50, 119))
    assert capture.num_frames == 70 and error_m(capture, demo, 50) < 0.02
    with pytest.raises(JobInvalid, match="Frames 150 to 200 are not a valid range in this take of 200 frames"):
        read(root, frames=(150, 200))
    (root / "Config.toml").write_text("[project]\nframe_range = [10, 60]\n")
    configured = read(root)
    assert configured.num_frames == 50 and error_m(configured, demo, 10) < 0.02
    assert any("Config.toml selects frames" in note for note in words(configured.notes))
    assert read(root, frames=(0, 199)).num_frames == 200
