"""Cameras of other rates, and calibrations meant otherwise, are found where cameras started apart as well."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solver_backend.agreement.starts import at_one_rate, rates_by_length, rates_match, read_out_of_step
from solver_backend.cameras.camera_corrections import CameraCorrection
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.types import Detections
from tests.support.scenes import detected, ring_of_cameras, walker

CAMERAS, KEYPOINTS = demo_capture().require_multiview()
COUNT = len(CAMERAS)
RATES = np.array([1.0, 1.0, 1.0, 0.5])


def recorded(starts: list[int], rates: list[float]) -> Detections:
    """Return the demo by cameras that started at these frames and took so many pictures a frame of the demo."""
    xy = np.full((COUNT, 2 * KEYPOINTS.num_frames, 1, *KEYPOINTS.xy.shape[2:]), np.nan, np.float32)
    confidence, lengths = np.zeros(xy.shape[:-1], np.float32), []
    for c, (start, rate) in enumerate(zip(starts, rates, strict=True)):
        at = np.arange(start, KEYPOINTS.num_frames - 1, 1 / rate)
        row, share = np.floor(at).astype(int), (at % 1)[:, None, None]
        xy[c, : len(at), 0] = (1 - share) * KEYPOINTS.xy[c, row] + share * KEYPOINTS.xy[c, row + 1]
        confidence[c, : len(at), 0] = np.minimum(KEYPOINTS.confidence[c, row], KEYPOINTS.confidence[c, row + 1])
        lengths.append(len(at))
    confidence[np.isnan(xy).any(-1)] = 0.0
    most = max(lengths)
    return Detections(
        CAMERAS.names, xy[:, :most], confidence[:, :most], KEYPOINTS.joint_set, first_frames=(0,) * COUNT,
        lengths=tuple(lengths),
    )  # fmt: skip


def half(seen: Detections, chosen: list[int]) -> Detections:
    xy = seen.xy.copy()
    xy[chosen] = (xy[chosen] + 0.5) / 2 - 0.5
    return replace(seen, xy=xy)


@pytest.mark.slow
@pytest.mark.parametrize(("starts", "rates"), [([0, 0, 0, 0], [1, 1, 0.5, 0.5]), ([60, 0, 0, 9], [0.5, 0.5, 0.5, 1])])
def test_stated_frame_rates_are_believed_where_the_views_match_by_them(starts: list[int], rates: list[float]) -> None:
    assert rates_match(CAMERAS, recorded(starts, rates), np.array(rates))
    assert not rates_match(CAMERAS, recorded(starts, [1, 1, 1, 1]), np.array(rates))


def test_one_camera_of_another_rate_among_many_is_found() -> None:
    cameras, rate, rng = ring_of_cameras(7), 5 / 6, np.random.default_rng(0)
    xy, confidence = detected(cameras, walker(KEYPOINTS.joint_set, 90, (-0.8, 0.3), (0.6, 0.1)), rng)
    lengths = [90] * 6 + [75]
    xy[6, :75], confidence[6, 75:] = xy[6, np.round(np.arange(75) / rate).astype(int)], 0.0
    xy[confidence == 0] = np.nan
    seen = Detections(
        cameras.names, xy[:, :, None].astype(np.float32), confidence[:, :, None].astype(np.float32),
        KEYPOINTS.joint_set, first_frames=(0,) * 7, lengths=tuple(lengths),
    )  # fmt: skip
    np.testing.assert_allclose(rates_by_length(cameras, seen), [1, 1, 1, 1, 1, 1, rate], atol=1e-6)


@pytest.mark.parametrize("rate", [24 / 120, 24 / 48, 24 / 30, 1.0])
def test_usual_rates_are_found_by_the_numbers_of_frames(rate: float) -> None:
    """The second camera also lacks two frames of the take."""
    found = rates_by_length(CAMERAS, recorded([200, 202, 200, 200], [1, rate, 1, 1]))
    np.testing.assert_allclose(found, [1, rate, 1, 1])


@pytest.mark.slow
def test_pictures_of_another_size_are_found_whenever_cameras_started() -> None:
    reading = read_out_of_step(CAMERAS, half(recorded([0, 45, 90, 20], [1, 1, 1, 1]), [0, 1, 2, 3]))
    assert reading is not None
    assert [reading.correction(view) for view in range(COUNT)] == [CameraCorrection(factor=0.5)] * COUNT


def test_matching_views_stay_as_they_are() -> None:
    assert read_out_of_step(CAMERAS, recorded([0, 45, 90, 20], [1, 1, 1, 1])) is None


@pytest.mark.slow
def test_what_nothing_explains_stays() -> None:
    seen = recorded([0, 0, 0, 0], [1, 1, 1, 1])
    xy = seen.xy.copy()
    xy[1:] = np.random.default_rng(0).uniform(0, 1000, xy[1:].shape)
    assert read_out_of_step(CAMERAS, replace(seen, xy=xy)) is None


@pytest.mark.slow
def test_a_person_who_stands_still_tells_nothing() -> None:
    seen = recorded([0, 0, 0, 0], [1, 1, 1, 1])
    still = replace(seen, xy=np.repeat(seen.xy[:, :1], seen.num_frames, axis=1))
    assert read_out_of_step(CAMERAS, still) is None


def test_detections_are_brought_to_one_rate_between_frames() -> None:
    seen = recorded([0, 0, 0, 0], [1, 1, 1, 0.5])
    moved = at_one_rate(seen, RATES)
    np.testing.assert_array_equal(moved.xy[:3], seen.xy[:3])
    rows = np.arange(0, 300, 2)
    np.testing.assert_allclose(moved.xy[3, rows], seen.xy[3, rows // 2], atol=1e-3)
    between = moved.xy[3, rows + 1]
    known = np.isfinite(between).all(-1) & np.isfinite(KEYPOINTS.xy[3, rows + 1, :][:, None]).all(-1)
    off = np.linalg.norm(between - KEYPOINTS.xy[3, rows + 1][:, None], axis=-1)[known]
    assert np.median(off) < 8.0, "about the detector's noise"
    assert moved.num_frames == pytest.approx(KEYPOINTS.num_frames, abs=3)


def test_people_who_change_places_in_the_list_are_not_mixed() -> None:
    seen = recorded([0, 0, 0, 0], [1, 1, 1, 0.5])
    two = np.concatenate([seen.xy, seen.xy + 500.0], axis=2)
    two[3, 1::2] = two[3, 1::2, ::-1]
    moved = at_one_rate(replace(seen, xy=two, confidence=np.repeat(seen.confidence, 2, axis=2)), RATES)
    given = {round(float(x), 1) for x in two[3, ..., 0].ravel() if np.isfinite(x)}
    found = moved.xy[3, :300, ..., 0].ravel()
    assert all(round(float(x), 1) in given for x in found[np.isfinite(found)])


def test_hands_are_brought_along() -> None:
    seen = recorded([0, 0, 0, 0], [1, 1, 1, 0.5])
    frames = np.arange(seen.num_frames, dtype=np.float32)[None, :, None, None, None, None]
    hands = np.broadcast_to(frames, (COUNT, seen.num_frames, 1, 2, 21, 3)).copy()
    hands[..., 2] = 0.5
    moved = at_one_rate(replace(seen, hands=hands), RATES)
    assert moved.hands is not None and moved.hands.shape[:3] == moved.confidence.shape[:3]
    np.testing.assert_array_equal(moved.hands[0], hands[0])
    known = (seen.confidence[3, :100] > 0).any((1, 2)) & (seen.confidence[3, 1:101] > 0).any((1, 2))
    np.testing.assert_allclose(moved.hands[3, 1:200:2, 0, 0, 0, 0][known], (np.arange(100) + 0.5)[known], atol=1e-4)
