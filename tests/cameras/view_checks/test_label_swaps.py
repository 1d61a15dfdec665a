"""Exchanged limbs are put right with two, three, four and eight views, and clean detections are left alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solver_backend.agreement.view_faults import EXCHANGED, exchanged, limb_columns, undo_swaps
from solver_backend.cameras.robust_triangulation import triangulate
from solver_backend.synthesis.embedded.demo import demo_capture, tripods
from solver_backend.types import Capture, Keypoints2D
from tests.support.faulty import filmed_by, swapped

RATE_PER_MINUTE = 12.0


@pytest.fixture(scope="module")
def capture() -> Capture:
    return demo_capture()


def unswapped(capture: Capture):
    cameras, keypoints = capture.require_multiview()
    return undo_swaps(cameras, keypoints, triangulate(cameras, keypoints.xy, keypoints.confidence))


def drawn(capture: Capture, seed: int, lengths: tuple[int, int] = (3, 30)) -> list[tuple[int, str, int, int]]:
    """Return view, limbs, first and last frame of exchanges; of two views only one errs at a time."""
    rng = np.random.default_rng(seed)
    frames, taken, chosen = capture.num_frames, np.zeros((2, len(capture.cameras), capture.num_frames + 9), bool), []
    for view in range(len(capture.cameras)):
        for number, limb in enumerate(EXCHANGED):
            for _ in range(rng.poisson(RATE_PER_MINUTE * frames / capture.fps / 60)):
                length = int(rng.integers(lengths[0], lengths[1] + 1))
                first = int(rng.integers(0, frames - length))
                busy = taken[number] if len(capture.cameras) == 2 else taken[number, view : view + 1]
                if not busy[:, max(first - 4, 0) : first + length + 4].any():
                    taken[number, view, first : first + length] = True
                    chosen.append((view, limb, first, first + length - 1))
    return chosen


def mask_of(swaps: list[tuple[int, str, int, int]], shape: tuple[int, int]) -> dict[str, np.ndarray]:
    masks = {limb: np.zeros(shape, bool) for limb in EXCHANGED}
    for view, limb, first, last in swaps:
        masks[limb][view, first : last + 1] ^= True
    return masks


@pytest.mark.slow
@pytest.mark.parametrize("views", [2, 3, 4, 8])
def test_injected_exchanges_are_undone(capture, views):
    """Of exchanges of three frames or more."""
    undone = injected = false = 0
    for seed in range(max(1, 9 // views)):
        filmed = filmed_by(capture, tripods(np.array([0.0, 0.0, 0.95]), max(views, 4)), seed)
        filmed = filmed.views(list(range(views)))
        truth = drawn(filmed, seed)
        found = unswapped(swapped(filmed, truth)).found
        wanted = mask_of(truth, (views, filmed.num_frames))
        got = mask_of([(s.view, s.limb, s.first, s.last) for s in found], (views, filmed.num_frames))
        injected += len(truth)
        undone += sum(got[limb][view, a : b + 1].mean() > 0.5 for view, limb, a, b in truth)
        false += sum(int((got[limb] & ~wanted[limb]).sum()) for limb in EXCHANGED)
    assert injected >= 8
    assert undone >= 0.95 * injected, f"{undone} of {injected}"
    assert false <= 0.001 * 2 * views * max(1, 9 // views) * capture.num_frames


@pytest.mark.parametrize("views", [2, 3, 4])
def test_clean_detections_are_left_alone(capture, views):
    few = capture.views(list(range(views)))
    found = unswapped(few)
    assert found.found == ()
    np.testing.assert_array_equal(found.keypoints.xy, few.keypoints.xy)


@pytest.mark.slow
def test_the_points_are_as_good_as_without_exchanges(capture):
    truth = drawn(capture, 5)
    assert len(truth) >= 4
    bad = swapped(capture, truth)
    clean = triangulate(capture.cameras, capture.keypoints.xy, capture.keypoints.confidence).points
    before = triangulate(bad.cameras, bad.keypoints.xy, bad.keypoints.confidence).points
    after = unswapped(bad).triangulation.points
    error = [
        float(np.nanquantile(np.linalg.norm(p - capture.truth["keypoints3d"], axis=-1), 0.99))
        for p in (clean, before, after)
    ]
    assert error[2] < 1.1 * error[0] < 0.9 * error[1], error


def test_both_limbs_of_one_view_at_once_and_two_views_one_after_the_other(capture):
    truth = [(1, "arms", 60, 75), (1, "legs", 60, 75), (2, "legs", 200, 215), (3, "legs", 216, 230)]
    found = unswapped(swapped(capture, truth)).found
    assert [(s.view, s.limb) for s in found] == [t[:2] for t in truth]
    np.testing.assert_allclose([(s.first, s.last) for s in found], [t[2:] for t in truth], atol=1)


def test_an_exchange_at_the_ends_of_a_take_is_undone(capture):
    truth = [(0, "legs", 0, 9), (2, "arms", 350, 359)]
    found = unswapped(swapped(capture, truth)).found
    assert [(s.view, s.limb, s.first, s.last) for s in found] == truth


def test_limbs_half_seen_and_frames_without_anybody(capture):
    truth = [(1, "legs", 100, 120)]
    keypoints = swapped(capture, truth).keypoints
    confidence = keypoints.confidence.copy()
    left, _ = limb_columns(keypoints.joint_set, "legs")
    confidence[1][:, left[1:]] = 0
    confidence[:, 110:113] = 0
    confidence[:, 30:40] = 0
    bad = replace(capture, keypoints=Keypoints2D(keypoints.xy, confidence, keypoints.joint_set, keypoints.fps))
    found = unswapped(bad).found
    assert {(s.view, s.limb) for s in found} == {(1, "legs")}
    assert sum(s.last - s.first + 1 for s in found) >= 16


def test_exchanging_twice_changes_nothing(capture):
    swaps = list(unswapped(swapped(capture, [(1, "arms", 60, 75)])).found)
    twice = exchanged(exchanged(capture.keypoints, swaps), swaps)
    np.testing.assert_array_equal(twice.xy, capture.keypoints.xy)
    np.testing.assert_array_equal(twice.confidence, capture.keypoints.confidence)
