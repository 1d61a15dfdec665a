"""Delays of cameras are told to a third of a frame, one or several late; cameras in step stay in step."""

import tarfile
from dataclasses import replace

import numpy as np
import pytest

from solver_backend.agreement import lags
from solver_backend.agreement.synchronisation import estimate_delays, synchronised
from solver_backend.cameras.projection import project
from solver_backend.io.load import load_capture
from solver_backend.synthesis.embedded.demo import demo_capture, detect
from solver_backend.synthesis.faults import DEMO_DETECTOR
from solver_backend.synthesis.simulation.keypoint_detector import delayed
from solver_backend.types import FEET, LIMBS, Capture

EVERY = [0, 1, 2, 3]


@pytest.fixture(scope="module")
def capture() -> Capture:
    return demo_capture(num_frames=300)


def late(capture: Capture, frames: np.ndarray, seed: int = 3) -> Capture:
    """Return the capture filmed by cameras that run late by so many frames."""
    cameras = capture.cameras
    px = project(cameras, capture.truth["keypoints3d"])
    px = np.stack([delayed(track, delay) for track, delay in zip(px, frames, strict=True)])
    xy, confidence = detect(px, cameras.image_size, 60.0, DEMO_DETECTOR, np.random.default_rng(seed))
    return replace(capture, keypoints=replace(capture.keypoints, xy=xy, confidence=confidence))


def estimated(capture: Capture):
    keypoints = capture.keypoints
    compared = LIMBS["arms"] + LIMBS["legs"] + FEET
    limbs = [k for k, name in enumerate(keypoints.joint_set.keypoints) if name.endswith(compared)]
    return estimate_delays(capture.cameras, keypoints.xy[:, :, limbs], 24)


@pytest.mark.parametrize(
    "frames",
    [
        pytest.param(-5.0, marks=pytest.mark.slow),
        -2.3,
        0.0,
        pytest.param(0.5, marks=pytest.mark.slow),
        pytest.param(1.0, marks=pytest.mark.slow),
        5.0,
    ],
)
def test_one_late_camera(capture, frames):
    true = np.array([0.0, 0.0, frames, 0.0])
    found = estimated(late(capture, true))
    np.testing.assert_allclose(found.frames, true, atol=0.25)
    assert (found.sigma < 0.1).all()


def test_a_late_camera_that_sees_the_person_in_half_of_the_take(capture):
    true = np.array([0.0, 0.0, 4.0, 0.0])
    filmed = late(capture, true)
    filmed.keypoints.xy[2, 150:], filmed.keypoints.confidence[2, 150:] = np.nan, 0.0
    np.testing.assert_allclose(estimated(filmed).frames, true, atol=0.25)


@pytest.mark.parametrize(("views", "first", "last", "delay"), [(EVERY, 226, 300, 5.0), ([2], 0, 75, 10.0)])
def test_a_late_camera_in_a_quarter_of_the_take(capture, views, first, last, delay):
    true = np.array([0.0, 0.0, delay, 0.0])
    filmed = late(capture, true)
    away = np.ones(300, bool)
    away[first:last] = False
    for view in views:
        filmed.keypoints.xy[view, away], filmed.keypoints.confidence[view, away] = np.nan, 0.0
    found = estimated(filmed)
    np.testing.assert_allclose(found.frames, true, atol=0.35)
    assert found.moved.tolist() == [False, False, True, False]


@pytest.mark.parametrize("seed", range(4))
def test_a_view_of_the_first_seventh_of_a_take_has_no_known_delay(capture, seed):
    filmed = late(capture, np.zeros(4), seed)
    filmed.keypoints.xy[2, 40:], filmed.keypoints.confidence[2, 40:] = np.nan, 0.0
    found = estimated(filmed)
    assert np.isnan(found.frames[2]) and not found.moved.any()
    np.testing.assert_allclose(found.frames[[0, 1, 3]], 0.0, atol=0.25)


def test_half_a_second_of_cameras_in_step_has_no_delay(shared_data, tmp_path):
    with tarfile.open(shared_data / "cases" / "views4" / "ros_1.tar.xz") as archive:
        archive.extractall(tmp_path, filter="data")
    (folder,) = tmp_path.iterdir()
    assert not estimated(load_capture(folder)).moved.any()


def test_missing_keypoints_of_a_walking_person_make_no_delay(capture):
    points = capture.truth["keypoints3d"].copy()
    points[..., 0] += np.linspace(-1.5, 1.5, len(points))[:, None]
    walking = late(replace(capture, truth={"keypoints3d": points}), np.zeros(4)).keypoints
    missing = np.random.default_rng(0).uniform(size=walking.confidence.shape) < 0.3
    xy = np.where(missing[..., None], np.nan, walking.xy)
    found = estimated(replace(capture, keypoints=replace(walking, xy=xy)))
    np.testing.assert_allclose(found.frames, 0.0, atol=0.15)
    assert not found.moved.any()


@pytest.mark.parametrize("views", [[0, 1], EVERY], ids=["two views", "four views"])
def test_errors_of_delays_in_short_takes_are_as_large_as_their_deviations(views):
    short = demo_capture(num_frames=120)
    found = [estimated(late(short, np.zeros(4), seed).views(views)) for seed in range(6)]
    z = np.concatenate([delays.frames / delays.sigma for delays in found])
    assert np.sqrt(np.nanmean(z[z != 0] ** 2)) < 2.2, "the median camera has a delay of 0"
    assert not any(delays.moved.any() for delays in found)


def test_three_views(capture):
    true = np.array([0.0, 2.0, 0.0, 0.0])
    np.testing.assert_allclose(estimated(late(capture, true).views([0, 1, 2])).frames, true[:3], atol=0.35)


@pytest.mark.slow
@pytest.mark.parametrize(
    "frames", [(0.0, 7.0, 4.0, 0.0), (3.0, 1.0, 0.0, 2.0), (0.0, -9.6, 9.3, 1.5), (0.0, 1.3, -2.0, 0.6)]
)
def test_several_late_cameras(capture, frames):
    true = np.array(frames)
    found = estimated(late(capture, true)).frames
    np.testing.assert_allclose(found - np.median(found - true), true, atol=0.3)
    assert 0.0 in found


def test_two_views_tell_their_delay(capture):
    true = np.array([0.0, 0.0, 4.0, 0.0])
    found = estimated(late(capture, true).views([0, 2])).frames
    np.testing.assert_allclose(found[1] - found[0], 4.0, atol=0.35)


def test_a_camera_of_another_rate(capture):
    cameras = capture.cameras
    true = project(cameras, capture.truth["keypoints3d"])
    faster = np.arange(300) * 295.0 / 300.0
    low = np.floor(faster).astype(int)
    share = (faster - low)[:, None, None]
    true[1] = (1 - share) * true[1, low] + share * true[1, low + 1]
    xy, confidence = detect(true, cameras.image_size, 60.0, DEMO_DETECTOR, np.random.default_rng(5))
    found = estimated(replace(capture, keypoints=replace(capture.keypoints, xy=xy, confidence=confidence)))
    np.testing.assert_allclose(found.drift, [0.0, 2.5, 0.0, 0.0], atol=0.4)
    np.testing.assert_allclose(found.at(300)[1], np.arange(300) * 5.0 / 300.0, atol=0.5)


def test_people_who_stand_still_tell_nothing(capture):
    still = replace(capture, truth={"keypoints3d": np.repeat(capture.truth["keypoints3d"][:1], 300, axis=0)})
    found = estimated(late(still, np.array([0.0, 0.0, 8.0, 0.0])))
    assert np.isnan(found.frames).all() and not found.moved.any()
    assert (found.possible[:, 0] <= -8).all() and (found.possible[:, 1] >= 8).all()


def test_possible_delays_are_whole_frames_within_the_reach_and_never_minus_zero(capture):
    points = capture.truth["keypoints3d"]
    late_mover = np.concatenate([np.repeat(points[:1], 240, axis=0), points[:60]])
    found = estimated(late(replace(capture, truth={"keypoints3d": late_mover}), np.array([0.0, 0.0, 8.0, 0.0])))
    assert np.isnan(found.frames[2])
    assert found.possible[2, 0] >= -1.0 and found.possible[2, 1] == 8.0
    assert not np.signbit(found.possible[found.possible == 0.0]).any()


def test_little_movement_in_half_of_the_take_makes_no_delay_doubtful(capture):
    slower = np.round(np.linspace(0.0, 1.0, 300) ** 2 * 299).astype(int)
    true = np.array([0.0, 0.0, 4.0, 0.0])
    uneven = replace(capture, truth={"keypoints3d": capture.truth["keypoints3d"][slower]})
    np.testing.assert_allclose(estimated(late(uneven, true)).frames, true, atol=0.35)


def test_moved_detections_are_those_in_step(capture):
    keypoints = capture.keypoints
    moved = synchronised(keypoints, np.array([0.0, 2.0, 0.0, -0.5]))
    np.testing.assert_array_equal(moved.xy[[0, 2]], keypoints.xy[[0, 2]])
    np.testing.assert_array_equal(moved.xy[1, :-2], keypoints.xy[1, 2:])
    assert (moved.confidence[1, -2:] == 0).all() and (moved.confidence[3, 0] == 0).all()
    np.testing.assert_allclose(moved.xy[3, 1:], 0.5 * (keypoints.xy[3, 1:] + keypoints.xy[3, :-1]))


def test_a_long_take_is_compared_within_the_reach_alone(capture, monkeypatch):
    compared, disagreements = [], lags._disagreements
    monkeypatch.setattr(lags, "_disagreements", lambda *args: compared.append(disagreements(*args)) or compared[-1])
    xy = np.tile(capture.keypoints.xy, (1, 10, 1, 1))[:2, :, None]
    near, every = (lags.people_lags(capture.cameras.subset([0, 1]), xy, reach=reach) for reach in (20, None))
    np.testing.assert_allclose(near.gains[0, 1], every.gains[0, 1][2979:3020])
    *near, _ = np.split(np.array([one.size for one in compared]), [len(compared) - 11])
    assert np.sum(near) < 0.3 * np.sum([one.size for one in compared])
