"""Frames that are shown again are found where the view moves, and bridged."""

import numpy as np

from solver_backend.agreement.repeated_frames import LONGEST, repeated_frames, skipped_frames, without_repeats
from solver_backend.types import JointSet, Keypoints2D

FRAMES = 40


def moving(speed: float = 3.0, seed: int = 0) -> Keypoints2D:
    """Return two views of points that move evenly, with a missing keypoint here and there."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(100, 900, (2, 1, 17, 2)) + speed * np.arange(FRAMES)[:, None, None]
    confidence = (rng.uniform(size=(2, FRAMES, 17)) > 0.05).astype(float)
    return Keypoints2D(np.where(confidence[..., None] > 0, xy, np.nan), confidence, JointSet.COCO_17, 60.0)


def held(keypoints: Keypoints2D, frames: np.ndarray) -> Keypoints2D:
    """Return what the first view shows when it has these frames in place of its own."""
    xy, confidence = keypoints.xy.copy(), keypoints.confidence.copy()
    xy[0], confidence[0] = xy[0, frames], confidence[0, frames]
    return Keypoints2D(xy, confidence, keypoints.joint_set, keypoints.fps)


def test_a_view_at_half_the_rate_is_found_and_put_on_its_way():
    truth = moving()
    given = held(truth, np.arange(FRAMES) // 2 * 2)
    again = repeated_frames(given)
    assert not again[1].any()
    np.testing.assert_array_equal(again[0], np.arange(FRAMES) % 2 == 1)
    bridged = without_repeats(given, again)
    seen = bridged.confidence[0, : FRAMES - 1] > 0
    np.testing.assert_allclose(bridged.xy[0, : FRAMES - 1][seen], moving_everywhere()[0, : FRAMES - 1][seen], atol=1e-9)
    assert (bridged.confidence[0, -1] == 0).all()  # nobody knows where the last one led


def moving_everywhere() -> np.ndarray:
    rng = np.random.default_rng(0)
    return rng.uniform(100, 900, (2, 1, 17, 2)) + 3.0 * np.arange(FRAMES)[:, None, None]


def test_people_who_stand_still_are_no_repetition():
    assert not repeated_frames(moving(speed=0.0)).any()


def test_a_long_freeze_shows_nothing():
    stop = np.where((np.arange(FRAMES) >= 10) & (np.arange(FRAMES) <= 12 + LONGEST), 10, np.arange(FRAMES))
    given = held(moving(), stop)
    again = repeated_frames(given)
    np.testing.assert_array_equal(np.flatnonzero(again[0]), np.arange(11, 13 + LONGEST))
    assert (without_repeats(given, again).confidence[0, 11 : 13 + LONGEST] == 0).all()


def test_what_is_no_repetition_stays_bit_for_bit():
    given = moving()
    again = repeated_frames(given)
    assert not again.any()
    after = without_repeats(given, again)
    np.testing.assert_array_equal(after.xy, given.xy)
    np.testing.assert_array_equal(after.confidence, given.confidence)


def test_a_detector_that_skips_frames_is_found_and_bridged():
    truth = moving()
    empty = np.arange(FRAMES) % 3 != 0
    given = Keypoints2D(truth.xy, np.where(empty[:, None], 0.0, truth.confidence), truth.joint_set, truth.fps)
    skipped = skipped_frames(given)
    np.testing.assert_array_equal(skipped, empty)
    bridged = without_repeats(given, np.broadcast_to(skipped, (2, FRAMES)))
    seen = bridged.confidence > 0
    np.testing.assert_allclose(bridged.xy[seen], moving_everywhere()[seen], atol=1e-9)
    assert seen.mean() > 0.85


def test_somebody_who_leaves_is_not_skipped():
    truth = moving()
    away = (np.arange(FRAMES) > 5) & (np.arange(FRAMES) < 30)
    given = Keypoints2D(truth.xy, np.where(away[:, None], 0.0, truth.confidence), truth.joint_set, truth.fps)
    assert not skipped_frames(given).any()


def test_gaps_at_irregular_intervals_are_not_skipped():
    truth = moving()
    for gaps in ((20,), (5, 9, 23), (3, 6, 13, 15, 24, 31)):
        empty = np.isin(np.arange(FRAMES), gaps)
        given = Keypoints2D(truth.xy, np.where(empty[:, None], 0.0, truth.confidence), truth.joint_set, truth.fps)
        assert not skipped_frames(given).any()
