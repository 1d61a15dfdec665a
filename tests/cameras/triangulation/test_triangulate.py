"""Triangulation: known points come back, outliers are rejected, covariances are calibrated, gaps are NaN."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from solver_backend.cameras import robust_triangulation as triangulation
from solver_backend.cameras.projection import project
from solver_backend.cameras.robust_triangulation import triangulate
from solver_backend.exchange.errors import CalibrationMismatch, KeypointCountMismatch, TooFewViews
from solver_backend.types import Cameras
from tests.support.camera_ring import record, ring

MEDIAN_CHI2_3 = 2.366


def knock(xy: np.ndarray, chosen: np.ndarray, by_px: float, seed: int = 1) -> np.ndarray:
    """Return detections of which the chosen are off by so many pixels, in random directions."""
    angle = np.random.default_rng(seed).uniform(0, 2 * np.pi, chosen.shape)
    return xy + by_px * chosen[..., None] * np.stack([np.cos(angle), np.sin(angle)], -1)


@pytest.mark.parametrize("model", ["opencv", "fisheye"])
@pytest.mark.parametrize("count", [2, 3, 4, 7])
def test_clean_detections_give_the_points_back(model, count):
    cameras = ring(count, model)
    points, xy, confidence = record(cameras, 40, 3, 0.0)
    found = triangulate(cameras, xy, confidence, 1.0)
    known = np.isfinite(found.points).all(-1)
    assert known.mean() > (0.9 if count == 2 else 0.9999)
    np.testing.assert_allclose(found.points[known], points[known], atol=1e-6)
    assert found.inliers[:, known].all() and np.nanmax(found.residual_px) < 1e-3


@pytest.mark.parametrize(
    "count", [3, pytest.param(4, marks=pytest.mark.slow), pytest.param(6, marks=pytest.mark.slow), 9]
)
def test_covariance_is_calibrated(count):
    """The Mahalanobis distance of the error has the median of χ² with three degrees of freedom."""
    cameras = ring(count)
    points, xy, confidence = record(cameras, 800, 5, 2.5)
    found = triangulate(cameras, xy, confidence)
    assert np.isfinite(found.points).all()
    error = found.points - points
    distance = np.einsum("fki,fkij,fkj->fk", error, np.linalg.inv(found.covariance), error)
    assert np.median(distance) == pytest.approx(MEDIAN_CHI2_3, rel=0.1)
    np.testing.assert_allclose(found.sigma_px, 2.5, rtol=0.1)
    np.testing.assert_allclose(found.covariance, np.swapaxes(found.covariance, -1, -2), atol=1e-12)


@pytest.mark.parametrize("sigma", [None, 2.0])
@pytest.mark.parametrize("count", [4, 5, 6, 8])
def test_one_view_off_by_80_px_is_rejected(count, sigma):
    cameras = ring(count)
    points, xy, confidence = record(cameras, 300, 10, 2.0)
    victim = np.random.default_rng(2).integers(0, count, points.shape[:2]) == np.arange(count)[:, None, None]
    found = triangulate(cameras, knock(xy, victim, 80.0), confidence, sigma)
    error = np.linalg.norm(found.points - points, axis=-1)
    assert (error < 0.05).mean() > 0.995
    assert found.inliers[victim].mean() < 0.003
    assert found.inliers[~victim].mean() > 0.98


@pytest.mark.parametrize("sigma", [None, 1.0])
def test_one_wrong_view_of_three_is_rejected_unless_geometry_cannot_tell(sigma):
    cameras = ring(3)
    points, xy, confidence = record(cameras, 300, 10, 1.0)
    victim = np.random.default_rng(2).integers(0, 3, points.shape[:2]) == np.arange(3)[:, None, None]
    found = triangulate(cameras, knock(xy, victim, 80.0), confidence, sigma)
    error = np.linalg.norm(found.points - points, axis=-1)
    assert (error < 0.05).mean() > 0.93
    trusting = np.where(victim, 0.1, confidence)
    error = np.linalg.norm(triangulate(cameras, knock(xy, victim, 80.0), trusting, sigma).points - points, axis=-1)
    assert (error < 0.05).mean() > 0.98


def test_two_wrong_views_of_six_are_rejected():
    cameras = ring(6)
    points, xy, confidence = record(cameras, 300, 5, 2.0)
    order = np.argsort(np.random.default_rng(3).random((6, *points.shape[:2])), axis=0)
    found = triangulate(cameras, knock(xy, order < 2, 80.0), confidence)
    error = np.linalg.norm(found.points - points, axis=-1)
    assert (error < 0.06).mean() > 0.99


def test_confidence_weighs_the_views():
    """A fourth view with much noise and little confidence hurts less than one with full confidence."""
    cameras = ring(4)
    points, xy, _ = record(cameras, 400, 5, 1.0)
    xy[3] += 4.0 * np.random.default_rng(4).normal(size=xy[3].shape)
    even, low = np.ones(xy.shape[:-1]), np.ones(xy.shape[:-1])
    low[3] = 0.05
    errors = [np.linalg.norm(triangulate(cameras, xy, c, 4.0).points - points, axis=-1).mean() for c in (even, low)]
    assert errors[1] < 0.8 * errors[0]


def test_missing_views_give_nan_and_nothing_else_changes():
    cameras = ring(4)
    points, xy, confidence = record(cameras, 6, 2, 0.5)
    confidence[1:, 0, 0] = 0.0
    xy[1:, 1, 0] = np.nan
    confidence[:, 2] = 0.0
    confidence[2:, 3] = 0.0
    found = triangulate(cameras, xy, confidence, 1.0)
    lost = np.zeros((6, 2), dtype=bool)
    lost[[0, 1], 0] = lost[2] = True
    np.testing.assert_array_equal(np.isnan(found.points).all(-1), lost)
    np.testing.assert_array_equal(np.isnan(found.covariance).all((-1, -2)), lost)
    assert not found.inliers[:, lost].any() and np.isnan(found.residual_px[:, lost]).all()
    assert not found.inliers[2:, 3].any() and np.isnan(found.residual_px[2:, 3]).all()
    assert np.linalg.norm(found.points - points, axis=-1)[~lost].max() < 0.02


def test_two_views_that_contradict_each_other_give_no_point():
    cameras = ring(2, arc=np.pi / 2 * 2)
    _, xy, confidence = record(cameras, 20, 1, 0.0)
    xy[0, ..., 1] += 80.0
    assert np.isnan(triangulate(cameras, xy, confidence, 2.0).points).all()


def test_rays_that_do_not_cross_give_no_point():
    """Two cameras in one place, and two that face each other, cannot tell the depth."""
    one = ring(2)
    twins = Cameras(("a", "b"), one.K, one.distortion, one.R[[0, 0]], one.t[[0, 0]], one.image_size)
    _, xy, confidence = record(twins, 10, 2, 0.0)
    assert np.isnan(triangulate(twins, xy, confidence, 2.0).points).all()
    middle = np.tile([0.0, 0.0, 1.0], (1, 1, 1))
    R = np.array([[[1.0, 0, 0], [0, 0, -1], [0, 1, 0]], [[-1.0, 0, 0], [0, 0, -1], [0, -1, 0]]])
    facing = Cameras(("a", "b"), one.K, one.distortion, R, np.tile([0.0, 1.0, 4.0], (2, 1)), one.image_size)
    xy = project(facing, middle)
    assert np.isnan(triangulate(facing, xy, np.ones((2, 1, 1)), 2.0).points).all()


def test_a_point_behind_the_cameras_is_not_invented():
    """Rays that diverge meet behind the cameras; that is no point."""
    cameras = ring(2, arc=np.pi / 4)
    xy = np.tile(cameras.image_size[:, None, None] / 2.0, (1, 1, 1, 1)).astype(float)
    right = project(cameras, np.array([[[0, 0, 1.0]]]))
    for shift in ([900.0, -900.0], [-900.0, 900.0]):
        apart = right + np.array(shift)[:, None, None, None] * [1.0, 0.0]
        found = triangulate(cameras, apart, np.ones(xy.shape[:-1]), 5.0)
        depth = np.einsum("cj,fkj->cfk", cameras.R[:, 2], found.points) + cameras.t[:, 2, None, None]
        assert np.isnan(found.points).all() or (depth > 0).all()


def test_batch_equals_loop_and_chunks_do_not_show(monkeypatch):
    cameras = ring(4)
    _, xy, confidence = record(cameras, 9, 3, 2.0)
    whole = triangulate(cameras, xy, confidence, 2.0)
    monkeypatch.setattr(triangulation, "_CHUNK", 30)
    pieces = triangulate(cameras, xy, confidence, 2.0)
    for name in ("points", "covariance", "inliers", "residual_px"):
        np.testing.assert_allclose(getattr(pieces, name), getattr(whole, name), atol=1e-9)
    for f in range(9):
        one = triangulate(cameras, xy[:, f : f + 1], confidence[:, f : f + 1], 2.0)
        np.testing.assert_allclose(one.points[0], whole.points[f], atol=1e-9)


def test_progress_is_shown_block_by_block(monkeypatch):
    cameras = ring(4)
    _, xy, confidence = record(cameras, 12, 5, 2.0)
    monkeypatch.setattr(triangulation, "_CHUNK", 4 * 5 * 3)
    shown = list[tuple[int, int]]()
    triangulate(cameras, xy, confidence, 2.0, progress=lambda stage, done, total: shown.append((done, total)))
    assert shown == [(0, 1), (1, 4), (2, 4), (3, 4), (4, 4)]


def test_no_frames_and_no_detections():
    cameras = ring(3)
    empty = triangulate(cameras, np.zeros((3, 0, 4, 2)), np.zeros((3, 0, 4)))
    assert empty.points.shape == (0, 4, 3) and empty.covariance.shape == (0, 4, 3, 3)
    assert empty.inliers.shape == empty.residual_px.shape == (3, 0, 4) and empty.sigma_px.shape == (4,)
    dark = triangulate(cameras, np.full((3, 5, 4, 2), np.nan), np.zeros((3, 5, 4)))
    assert np.isnan(dark.points).all() and not dark.inliers.any() and np.isfinite(dark.sigma_px).all()


def test_noise_is_measured_per_keypoint_despite_outliers():
    cameras = ring(5)
    _points, xy, confidence = record(cameras, 1200, 3, 0.0)
    rng = np.random.default_rng(5)
    sigma = np.array([1.5, 2.5, 4.0])
    xy = xy + sigma[:, None] * rng.normal(size=xy.shape)
    xy = knock(xy, rng.random(xy.shape[:-1]) < 0.08, 80.0)
    np.testing.assert_allclose(triangulate(cameras, xy, confidence).sigma_px, sigma, rtol=0.12)
    given = triangulate(cameras, xy, confidence, sigma)
    np.testing.assert_array_equal(given.sigma_px, sigma)


@pytest.mark.parametrize("sigma", [0.3, 2.0, 20.0])
@pytest.mark.parametrize("count", [2, 3, 5])
def test_noise_of_any_size_is_found(count, sigma):
    cameras = ring(count, arc=2 * np.pi if count > 2 else np.pi)
    _, xy, confidence = record(cameras, 1500, 1, sigma)
    xy = knock(xy, np.random.default_rng(7).random(xy.shape[:-1]) < 0.1, max(80.0, 12 * sigma))
    np.testing.assert_allclose(triangulate(cameras, xy, confidence).sigma_px, sigma, rtol=0.12)


@pytest.mark.parametrize("sigma", [None, 2.0])
def test_torch_equals_numpy(sigma):
    cameras = ring(4)
    _, xy, confidence = record(cameras, 60, 4, 2.0)
    xy = knock(xy, np.random.default_rng(6).random(xy.shape[:-1]) < 0.1, 80.0)
    confidence[1, 3:9] = 0.0
    expected = triangulate(cameras, xy, confidence, sigma)
    found = triangulate(cameras, torch.as_tensor(xy), torch.as_tensor(confidence), sigma)
    for name in ("points", "covariance", "inliers", "residual_px", "sigma_px"):
        np.testing.assert_allclose(getattr(found, name).numpy(), getattr(expected, name), rtol=1e-6, atol=1e-6)


@pytest.mark.misshapen
def test_errors_say_what_is_wrong():
    cameras = ring(3)
    _, xy, confidence = record(cameras, 2, 2, 0.0)
    with pytest.raises(TooFewViews, match="Triangulation needs two cameras, but there is 1"):
        triangulate(cameras.subset([0]), xy[:1], confidence[:1])
    with pytest.raises(CalibrationMismatch, match="xy has 2 views, but there are 3 cameras"):
        triangulate(cameras, xy[:2], confidence[:2])
    with pytest.raises(KeypointCountMismatch, match=r"xy \(3, 2, 2, 2\) and confidence \(3, 2, 1\) must be"):
        triangulate(cameras, xy, confidence[..., :1])
