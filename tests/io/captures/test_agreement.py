"""Recordings with two faults at once, or cameras of other frame rates, read as one take that fits."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.errors import CalibrationInvalid, CaptureInvalid
from solver_backend.io.load import load_capture
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.types import Capture, JointSet
from tests.support.trial_files import mp4_bytes, write_trial
from tests.support.words import words

DEMO = demo_capture()
CAMERAS, KEYPOINTS = DEMO.require_multiview()
NAMES = CAMERAS.names


def write_apart(
    root: Path, starts: list[int], rates: list[float], factor: float = 1.0, stop: int = KEYPOINTS.num_frames
) -> None:
    """Write what cameras recorded that started at these frames, with so many pictures a frame of the demo."""
    xy, confidence = np.full_like(KEYPOINTS.xy, np.nan), np.zeros_like(KEYPOINTS.confidence)
    lengths = []
    for c, (start, rate) in enumerate(zip(starts, rates, strict=True)):
        at = np.round(np.arange(start, stop - 1, 1 / rate)).astype(int)
        xy[c, : len(at)], confidence[c, : len(at)] = KEYPOINTS.xy[c, at], KEYPOINTS.confidence[c, at]
        lengths.append(len(at))
    people = [((xy + 0.5) * factor - 0.5, confidence)]
    config = "[project]\nframe_rate = 60\n"
    write_trial(root, cameras=CAMERAS, people=people, lengths=lengths, names=NAMES, calibrated=NAMES, config=config)


def median_error_m(capture: Capture, first: int) -> float:
    """Return how far triangulated points are from the truth, the capture beginning at this frame of the demo."""
    from solver_backend.cameras.robust_triangulation import triangulate

    cameras, keypoints = capture.require_multiview()
    points = np.asarray(triangulate(cameras, keypoints.xy, keypoints.confidence).points)
    truth = DEMO.truth["keypoints3d"][first : first + capture.num_frames]
    return float(np.nanmedian(np.linalg.norm(points[: len(truth)] - truth, axis=-1)))


@pytest.mark.slow
def test_half_size_and_started_apart(tmp_path: Path) -> None:
    write_apart(tmp_path, [0, 45, 90, 20], [1, 1, 1, 1], factor=0.5)
    capture = load_capture(tmp_path)
    assert median_error_m(capture, 90) < 0.03
    assert any("0.5 times as large" in problem and "--as-calibrated" in problem for problem in words(capture.problems))
    assert any("did not start together" in problem for problem in words(capture.problems))


def test_half_size_and_other_lengths(tmp_path: Path) -> None:
    write_apart(tmp_path, [0, 0, 0, 0], [1, 1, 1, 1], factor=0.5, stop=181)
    for path in sorted((tmp_path / "pose" / f"{NAMES[2]}_json").iterdir())[-7:]:
        path.unlink()
    capture = load_capture(tmp_path)
    assert median_error_m(capture, 0) < 0.03
    (corrected,) = [item for item in capture.problems if item.code.startswith("calibration_corrected")]
    assert "0.5 times as large" in corrected.values["meanings"]


@pytest.mark.slow
@pytest.mark.parametrize("filmed", [pytest.param(False, marks=pytest.mark.slow), True])
def test_a_camera_of_half_the_frame_rate(tmp_path: Path, filmed: bool) -> None:
    write_apart(tmp_path, [0, 0, 0, 0], [1, 1, 1, 0.5])
    if filmed:
        (tmp_path / "videos").mkdir()
        for name, fps, frames in zip(NAMES, (60, 60, 60, 30), (359, 359, 359, 180), strict=True):
            (tmp_path / "videos" / f"{name}.mp4").write_bytes(mp4_bytes(fps, frames, (1920, 1080)))
    capture = load_capture(tmp_path)
    assert capture.fps == 60.0
    assert capture.num_frames == pytest.approx(KEYPOINTS.num_frames, abs=3)
    assert median_error_m(capture, 0) < 0.03
    (found,) = [item for item in capture.problems if item.code == "camera_rates_differ"]
    assert found.where.cameras == (NAMES[3],) and found.values["rates"] == [f"{NAMES[3]} 30"]
    assert (found.values["rate"], found.values["basis"]) == (60.0, "known")
    assert [path is not None for path in capture.footage] == [True, True, True, False] * filmed


@pytest.mark.slow
@pytest.mark.parametrize(("first", "frames"), [(100, 60), (0, 60), (200, 60), (240, 90)])
def test_a_camera_of_half_the_frame_rate_in_a_short_take(tmp_path: Path, first: int, frames: int) -> None:
    """The number of pictures is half that of the others: no other start, and no lens, is the reason."""
    write_apart(tmp_path, [first] * 4, [1, 0.5, 1, 1], stop=first + frames + 1)
    capture = load_capture(tmp_path)
    assert capture.num_frames == pytest.approx(frames, abs=1)
    assert median_error_m(capture, first) < 0.03
    (found,) = capture.problems
    assert found.code == "camera_rates_differ" and found.values["rates"] == [f"{NAMES[1]} 30"]


def test_a_camera_that_stopped_halfway_is_of_the_same_rate(tmp_path: Path) -> None:
    write_apart(tmp_path, [60] * 4, [1, 1, 1, 1], stop=121)
    for path in sorted((tmp_path / "pose" / f"{NAMES[1]}_json").iterdir())[30:]:
        path.unlink()
    codes = [item.code for item in load_capture(tmp_path).problems]
    assert "camera_rates_differ" not in codes and "starts_apart" not in codes


def test_calibrations_as_written_are_not_searched(tmp_path: Path) -> None:
    write_apart(tmp_path, [0, 0, 0, 0], [1, 1, 1, 1], factor=0.5, stop=61)
    capture = load_capture(tmp_path, as_calibrated=True)
    assert not any("corrected" in item.code for item in capture.problems)
    np.testing.assert_allclose(capture.require_multiview()[0].K, replace(CAMERAS).K)


@pytest.mark.slow
def test_v_counted_from_below(tmp_path: Path) -> None:
    xy = KEYPOINTS.xy.copy()
    xy[..., 1] = CAMERAS.image_size[:, 1, None, None] - 1 - xy[..., 1]
    write_trial(tmp_path, cameras=CAMERAS, people=[(xy, KEYPOINTS.confidence)], names=NAMES, calibrated=NAMES)
    capture = load_capture(tmp_path)
    assert median_error_m(capture, 0) < 0.03
    (found,) = [item for item in capture.problems if item.code == "detections_corrected"]
    assert "y counts from the bottom" in found.values["found"] and "--as-calibrated" in words([found])[0]
    kept = load_capture(tmp_path, as_calibrated=True)
    assert "detections_corrected" not in [item.code for item in kept.problems]


def test_views_that_agree_in_step_are_of_one_rate(tmp_path: Path) -> None:
    """Short takes of few keypoints match at no offset clearly, and yet agree as they are numbered."""
    names = KEYPOINTS.joint_set.keypoints
    columns = [names.index(name) if name in names else names.index("nose") for name in JointSet.MPII_15.keypoints]
    columns.append(names.index("neck"))
    people = [(KEYPOINTS.xy[:, :40, columns], KEYPOINTS.confidence[:, :40, columns])]
    write_trial(tmp_path, cameras=CAMERAS, people=people, names=NAMES, calibrated=NAMES)
    capture = load_capture(tmp_path, joint_set=JointSet.MPII_15)
    assert capture.num_frames == 40
    assert "camera_rates_differ" not in [item.code for item in capture.problems]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("places", "turned"),
    [
        (1, False),
        pytest.param(2, False, marks=pytest.mark.slow),
        pytest.param(3, False, marks=pytest.mark.slow),
        (1, True),
    ],
)
def test_names_of_a_ring_turned_on(tmp_path: Path, places: int, turned: bool) -> None:
    """Every camera bears its neighbour's name: no size or shape of the pictures is an explanation."""
    order = np.roll(np.arange(4), -places)
    xy = KEYPOINTS.xy[order][:, 60:180]
    if turned:
        xy = np.stack([CAMERAS.image_size[order, None, None, 1] - 1 - xy[..., 1], xy[..., 0]], axis=-1)
    people = [(xy, KEYPOINTS.confidence[order][:, 60:180])]
    write_trial(tmp_path, cameras=CAMERAS, people=people, names=NAMES, calibrated=NAMES)
    capture = load_capture(tmp_path)
    (exchanged,) = [item for item in capture.problems if item.code == "camera_names_exchanged"]
    assert f"{NAMES[0]} is the calibration's {NAMES[order[0]]}" in exchanged.values["pairs"]
    corrections = [item.values["meanings"] for item in capture.problems if item.code == "calibration_corrected"]
    assert corrections == (
        ["the recorded images are rotated by 90° clockwise relative to the calibrated ones"] * turned
    )
    assert median_error_m(capture, 60) < 0.03


def test_cameras_in_one_place_are_refused_by_name(tmp_path: Path) -> None:
    cameras = replace(CAMERAS, R=np.tile(np.eye(3), (4, 1, 1)), t=np.zeros((4, 3)))
    people = [(KEYPOINTS.xy[:, :30], KEYPOINTS.confidence[:, :30])]
    write_trial(tmp_path, cameras=cameras, people=people, names=NAMES, calibrated=NAMES)
    with pytest.raises(CalibrationInvalid, match="All cameras are at one point"):
        load_capture(tmp_path)


def test_detections_copied_from_another_camera_are_refused_by_name(tmp_path: Path) -> None:
    xy, confidence = KEYPOINTS.xy[:, :30].copy(), KEYPOINTS.confidence[:, :30].copy()
    confidence[2:] = 0.0  # two views of nobody are no copies
    write_trial(tmp_path / "nobody", cameras=CAMERAS, people=[(xy, confidence)], names=NAMES, calibrated=NAMES)
    load_capture(tmp_path / "nobody")
    xy[3], confidence[3] = xy[1], confidence[1]
    write_trial(tmp_path / "copied", cameras=CAMERAS, people=[(xy, confidence)], names=NAMES, calibrated=NAMES)
    with pytest.raises(CaptureInvalid, match=f"Cameras {NAMES[1]} and {NAMES[3]} have exactly the same detections"):
        load_capture(tmp_path / "copied")


@pytest.mark.slow
def test_a_moved_camera_is_placed_by_the_others_and_named(tmp_path: Path) -> None:
    t = CAMERAS.t.copy()
    t[1] += [0.4, -0.4, 0.1]
    people = [(KEYPOINTS.xy[:, :120], KEYPOINTS.confidence[:, :120])]
    moved = replace(CAMERAS, t=t)
    write_trial(tmp_path, cameras=moved, people=people, names=NAMES, calibrated=NAMES)
    capture = load_capture(tmp_path)
    assert median_error_m(capture, 0) < 0.03
    (found,) = [item for item in capture.problems if item.code == "camera_placed"]
    assert found.where.cameras == (NAMES[1],) and found.values["gain"] > 6
    (tmp_path / "again").mkdir()
    write_trial(tmp_path / "again" / "trial", cameras=moved, people=people, names=NAMES, calibrated=NAMES)
    kept = load_capture(tmp_path / "again" / "trial", as_calibrated=True)
    assert "camera_placed" not in {item.code for item in kept.problems}
