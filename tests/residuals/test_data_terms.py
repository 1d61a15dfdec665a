"""What every data term tells of its measurements: residuals, inliers, leverage, and variances that can be rescaled."""

from dataclasses import replace

import numpy as np
import pytest

from solver_backend.cameras.projection import project, project_with_jacobian
from solver_backend.residuals.positions import PositionTerm
from solver_backend.residuals.reprojection import ReprojectionTerm
from solver_backend.residuals.terms import DataTerm
from tests.support.filmed_points import POINTS, reprojection

PLAIN = 1e6  # A robust scale so large that every residual counts fully.


@pytest.fixture(params=["views", "positions", "whitened positions"])
def term(request) -> tuple[DataTerm, np.ndarray]:
    """A term and points near its measurements."""
    cameras, keypoints, points = reprojection()
    if request.param == "views":
        return ReprojectionTerm.of(cameras, keypoints, np.full(POINTS, 5.0), points), points
    rng = np.random.default_rng(3)
    weight = np.where(rng.random(points.shape[:2]) < 0.2, 0.0, 2500.0)
    if request.param == "whitened positions":
        shape = rng.normal(size=(*points.shape, 3))
        covariance = 1e-4 * (shape @ shape.swapaxes(-1, -2) + 0.1 * np.eye(3))
        measured = np.where(weight[..., None] > 0, points + 0.02 * rng.normal(size=points.shape), np.nan)
        return PositionTerm.of(measured, covariance, points), points
    return PositionTerm(points + 0.02 * rng.normal(size=points.shape), weight), points


def test_residuals_are_what_the_cost_is_made_of(term):
    term, points = term
    found = term.residuals(points)
    confidence = getattr(term, "confidence", np.ones_like(found.squared))
    cost = 0.5 * (confidence * found.squared * found.measured).sum((0, 2))
    np.testing.assert_allclose(cost, term(points, PLAIN).cost, rtol=1e-6)
    assert np.isnan(found.deviations[~found.measured]).all() and (~found.measured).any()
    np.testing.assert_allclose(found.deviations[found.measured] ** 2, found.squared[found.measured])
    np.testing.assert_array_equal(found.error[~found.measured], 0.0)
    np.testing.assert_array_equal(found.inliers(2.0), found.deviations < 2.0)


def test_rescaling_the_variance_divides_squares_and_information(term):
    term, points = term
    views = term.residuals(points).squared.shape[0]
    variance = np.random.default_rng(4).uniform(0.5, 4.0, (views, 1, POINTS))
    before, after = term.residuals(points), term.rescaled(variance).residuals(points)
    np.testing.assert_allclose(after.squared * variance, before.squared, rtol=1e-12)
    np.testing.assert_array_equal(after.error, before.error)
    np.testing.assert_allclose(
        term.rescaled(np.full_like(variance, 4.0))(points, PLAIN).information, term(points, PLAIN).information / 4,
        rtol=1e-9, atol=1e-6,
    )  # fmt: skip


def test_selected_frames_are_judged_alike(term):
    term, points = term
    frames = np.array([2, 0])
    whole, part = term.residuals(points), term.select(frames).residuals(points[frames])
    np.testing.assert_allclose(part.squared, whole.squared[:, frames], rtol=1e-12)  # kernels add in orders of their own
    used = whole.measured
    some = term.select(frames).leverage(points[frames], used[:, frames])
    np.testing.assert_allclose(some, term.leverage(points, used)[:, frames], rtol=1e-9)


def test_single_precision_reaches_all_of_a_term(term):
    term, points = term
    exact, single = term(points, 3.0), term.astype(np.float32)(points.astype(np.float32), 3.0)
    for name in ("cost", "gradient", "information"):
        found, expected = getattr(single, name), getattr(exact, name)
        assert found.dtype == np.float32
        np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-4 * np.abs(expected).max())


def test_leverage_sums_to_the_points_freedoms(term):
    """The hat matrix of a point has trace 3; each view's share is the mean over its d rows."""
    term, points = term
    found = term.residuals(points)
    leverage = term.leverage(points, found.measured)
    enough = found.measured.sum(0) * found.error.shape[-1] >= 3
    np.testing.assert_allclose(leverage.sum(0)[enough], 3 / found.error.shape[-1], rtol=1e-4)
    np.testing.assert_array_equal(leverage[~found.measured], 0.0)


def test_leverage_is_how_far_a_refitted_point_follows_one_view():
    """By definition ``∂(fitted pixel) / ∂(measured pixel)``: every detection moved, every point fitted anew."""
    cameras, keypoints, points = reprojection()
    exact = project(cameras, points)
    term = ReprojectionTerm.of(cameras, replace(keypoints, xy=exact), np.full(POINTS, 5.0), points)
    used, step = term.residuals(points).measured, 1e-3

    def refitted(moved: ReprojectionTerm) -> np.ndarray:
        fitted = points
        for _ in range(3):
            evidence = moved(fitted, PLAIN)
            fitted = fitted - np.linalg.solve(evidence.information, evidence.gradient[..., None])[..., 0]
        return project_with_jacobian(cameras, fitted)[0]

    leverage = term.leverage(points, used)
    for view in range(len(cameras)):
        followed = np.zeros(points.shape[:2])
        for axis in range(2):
            xy = term.xy.copy()
            xy[view, ..., axis] += step
            followed += 0.5 * (refitted(replace(term, xy=xy)) - exact)[view, ..., axis] / step
        np.testing.assert_allclose(followed[used[view]], leverage[view][used[view]], atol=2e-4)
