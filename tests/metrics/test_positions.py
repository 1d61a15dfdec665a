"""Position errors against hand-made cases, invariances and refusals."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from solver_backend.exchange.errors import ShapeMismatch
from solver_backend.geometry.rotations import exp_so3
from solver_backend.metrics import distances_m, mpjpe_mm, pa_mpjpe_mm, pck_percent, rmse_mm, world_mpjpe_mm

FRAMES, POINTS = 5, 24


@pytest.fixture
def truth() -> np.ndarray:
    return np.random.default_rng(1).normal(size=(FRAMES, POINTS, 3))


def test_a_known_offset_is_its_length(truth):
    found = truth + np.array([0.003, 0.004, 0.0])
    assert mpjpe_mm(found, truth) == pytest.approx(5.0, abs=1e-9)
    assert rmse_mm(found, truth) == pytest.approx(5.0, abs=1e-9)
    assert mpjpe_mm(truth, truth) == 0.0


def test_rmse_weighs_large_errors_more(truth):
    found = truth.copy()
    found[0, 0, 2] += 1.0
    assert mpjpe_mm(found, truth) == pytest.approx(1000.0 / (FRAMES * POINTS))
    assert rmse_mm(found, truth) == pytest.approx(1000.0 / np.sqrt(POINTS) / FRAMES)


def test_rmse_is_of_each_sample_and_then_the_mean_as_eq_4_28_has_it(truth):
    off = np.array([1.0, 2.0, 3.0, 4.0, 10.0])
    found = truth + 0.001 * off[:, None, None] * np.array([1.0, 0.0, 0.0])
    assert rmse_mm(found, truth) == pytest.approx(off.mean())
    found[4] = np.nan
    assert rmse_mm(found, truth) == pytest.approx(off[:4].mean())
    assert rmse_mm(found[0], truth[0]) == pytest.approx(1.0)


@pytest.mark.parametrize("side", ["found", "truth"])
def test_missing_points_take_no_part(truth, side):
    found = truth + np.array([0.01, 0.0, 0.0])
    (found if side == "found" else truth)[2, 3:9] = np.nan
    assert mpjpe_mm(found, truth) == pytest.approx(10.0)
    assert rmse_mm(found, truth) == pytest.approx(10.0)
    assert np.isnan(distances_m(found, truth)).sum() == 6


def test_nothing_in_common_is_nan_without_a_warning(truth):
    nothing = np.full_like(truth, np.nan)
    assert np.isnan([mpjpe_mm(nothing, truth), rmse_mm(nothing, truth), pa_mpjpe_mm(nothing, truth)]).all()
    assert np.isnan(pck_percent(truth, nothing, 0.03))


@given(seed=st.integers(0, 10_000), scale=st.floats(0.2, 5.0))
def test_alignment_removes_any_similarity_of_each_frame(seed, scale):
    rng = np.random.default_rng(seed)
    truth = rng.normal(size=(3, 12, 3))
    R = exp_so3(rng.normal(size=(3, 3)) * 2)
    found = scale * truth @ np.swapaxes(R, -1, -2) + rng.normal(size=(3, 1, 3))
    found[1, :4] = np.nan
    assert pa_mpjpe_mm(found, truth) < 1e-9
    assert mpjpe_mm(found, truth) > 1.0


def test_alignment_never_makes_a_frame_worse(truth):
    found = truth + 0.02 * np.random.default_rng(2).normal(size=truth.shape)
    aligned = pa_mpjpe_mm(found, truth)
    assert 0.5 * mpjpe_mm(found, truth) < aligned < mpjpe_mm(found, truth)


def test_alignment_does_not_mirror():
    truth = np.random.default_rng(3).normal(size=(1, 10, 3))
    assert pa_mpjpe_mm(truth * [-1.0, 1.0, 1.0], truth) > 100.0


def test_pck_counts_points_within_the_threshold_and_unfound_ones_as_wrong():
    truth = np.zeros((1, 4, 3))
    found = np.zeros((1, 4, 3))
    found[0, :, 0] = [0.029, 0.031, 0.071, np.nan]
    assert pck_percent(found, truth, 0.03) == 25.0
    assert pck_percent(found, truth, 0.07) == 50.0
    truth[0, 3] = np.nan
    assert pck_percent(found, truth, 0.07) == pytest.approx(200.0 / 3)


@pytest.mark.misshapen
@pytest.mark.parametrize("metric", [mpjpe_mm, rmse_mm, pa_mpjpe_mm, distances_m])
def test_shapes_that_would_broadcast_are_refused(metric):
    with pytest.raises(ShapeMismatch, match=r"\(2, 3, 3\) and \(1, 3, 3\) cannot be compared.*\(\.\.\., points, 3\)"):
        metric(np.zeros((2, 3, 3)), np.zeros((1, 3, 3)))


@pytest.mark.misshapen
@pytest.mark.parametrize("shape", [(3,), (4, 2), ()])
def test_points_need_three_coordinates(shape):
    with pytest.raises(ShapeMismatch, match=r"has shape .*, but \(\.\.\., points, 3\) is expected"):
        mpjpe_mm(np.zeros(shape), np.zeros(shape))


def test_world_errors_align_each_hundred_frames_by_one_similarity_or_by_its_first_two() -> None:
    rng = np.random.default_rng(0)
    truth = np.cumsum(0.01 * rng.normal(size=(250, 5, 3)), axis=0) + rng.normal(size=(5, 3))
    turn = exp_so3(np.array([0.1, 0.4, -0.2]))
    moved = truth.copy()
    for start, scale in ((0, 1.1), (100, 0.9), (200, 1.0)):
        moved[start : start + 100] = scale * truth[start : start + 100] @ turn.T + start
    for fitted in (100, 2):
        assert world_mpjpe_mm(moved, truth, fitted) == pytest.approx(0.0, abs=1e-6)
    drifting = truth + np.linspace(0, 1, 250)[:, None, None] * [1.0, 0.0, 0.0]
    assert 0.0 < world_mpjpe_mm(drifting, truth) < world_mpjpe_mm(drifting, truth, 2)
    assert pa_mpjpe_mm(drifting, truth) == pytest.approx(0.0, abs=1e-6)
    missing = truth.copy()
    missing[3, 2] = np.nan
    assert world_mpjpe_mm(missing, truth) == pytest.approx(0.0, abs=1e-6)
    assert np.isnan(world_mpjpe_mm(truth[:1], truth[:1]))
