"""Markers whose error is longer in one direction: covariances of the tracker in the solve of markers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.body.markers import marker_landmarks, marker_layout
from solver_backend.fitters import SolveSettings, solve
from solver_backend.fitters.marker_calibration.calibrate import PRIOR_FRAMES, marker_sigma
from solver_backend.fitters.marker_calibration.marker_problem import moved_points
from solver_backend.fitters.measurements.markers import SIGMA_M
from solver_backend.fitters.model.subject import PosedFrames, Subject, pose
from solver_backend.fitters.pipeline import calibrate_person
from solver_backend.geometry.rotations import exp_so3
from solver_backend.residuals.positions import PositionTerm
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.types import Capture, MarkerCloud

LABELS = marker_layout("MANIFOLD_53")
FRAMES, FPS = 60, 60.0
LATERAL_M, DEPTH_M = 0.003, 0.015
SENSORS = np.array([[2.0, 0.0, 1.0], [-1.0, 1.7, 1.0], [-1.0, -1.7, 1.0]])


def true_markers() -> tuple[np.ndarray, np.ndarray]:
    """Return (F, 53, 3) markers near their places on a body, and its joints."""
    truth, body, rng = demo_capture().truth, load_body(), np.random.default_rng(8)
    places = 0.003 * rng.normal(size=(len(LABELS), 3))
    subject = Subject(body, marker_landmarks(body, LABELS), truth["betas"], places)
    local = exp_so3(truth["body_pose"][:FRAMES, :63].reshape(-1, 21, 3))
    frames = PosedFrames(exp_so3(truth["global_orient"][:FRAMES]), local, truth["transl"][:FRAMES])
    return pose(subject, frames).points, truth["joints"][:FRAMES]


def seen_by_depth(points: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return points with the error of one depth sensor each, and its covariance."""
    ray = points - SENSORS[rng.integers(len(SENSORS), size=points.shape[:2])]
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    along = ray[..., :, None] * ray[..., None, :]
    covariance = LATERAL_M**2 * (np.eye(3) - along) + DEPTH_M**2 * along
    error = np.linalg.cholesky(covariance) @ rng.normal(size=(*points.shape, 1))
    return points + error[..., 0], covariance


def error_mm(cloud: MarkerCloud, joints: np.ndarray, method: str) -> float:
    motion = solve(Capture("take", markers=cloud), SolveSettings(method=method)).motion
    return 1e3 * float(np.linalg.norm(motion.joints[:, :22] - joints[:, :22], axis=-1).mean())


@pytest.mark.slow
@pytest.mark.parametrize(("method", "ratio"), [("global", 0.93), ("frame", 0.88)])
def test_depth_five_times_as_noisy_is_fitted_better_with_covariances(method, ratio):
    markers, joints = true_markers()
    points, covariance = seen_by_depth(markers, np.random.default_rng(1))
    plain = MarkerCloud(points, FPS, LABELS)
    residual = replace(plain, residual=np.sqrt(np.trace(covariance, axis1=-2, axis2=-1) / 3))
    without, told = error_mm(plain, joints, method), error_mm(residual, joints, method)
    whole = error_mm(replace(plain, covariance=covariance), joints, method)
    assert whole < ratio * min(without, told), (whole, without, told)


@pytest.mark.slow
def test_equal_round_covariances_change_nothing():
    """Against residuals that say the same, of one person: a calibration takes covariances out of its spreads."""
    markers = true_markers()[0]
    points = markers + 0.002 * np.random.default_rng(2).normal(size=markers.shape)
    cloud = MarkerCloud(points, FPS, LABELS)
    person = calibrate_person([Capture("take", markers=cloud)])
    alike = np.tile(0.004**2 * np.eye(3), (*points.shape[:2], 1, 1))
    given = [replace(cloud, residual=np.full(points.shape[:2], 0.004)), replace(cloud, covariance=alike)]
    one, other = (solve(Capture("take", markers=item), SolveSettings(), person=person).motion for item in given)
    np.testing.assert_allclose(other.joints, one.joints, atol=1e-5)  # solved in single precision


def test_a_markers_own_spread_is_found_beside_the_trackers():
    rng, count = np.random.default_rng(3), 400
    points = rng.normal(size=(count, 5, 3))
    covariance = np.tile(np.diag([0.02**2, 0.003**2, 0.003**2]), (count, 5, 1, 1))
    sigma = np.array([0.004, 0.006, 0.008, 0.01, 0.012])
    noise = np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1)) * rng.normal(size=points.shape)
    measured = points + noise + sigma[:, None] * rng.normal(size=points.shape)
    term = PositionTerm.of(measured, covariance + SIGMA_M**2 * np.eye(3), points)
    found = marker_sigma(term, points, covariance)
    assert found == pytest.approx(sigma, rel=0.15)
    blind = marker_sigma(PositionTerm(measured, np.full((count, 5), SIGMA_M**-2)), points, 0.0 * covariance)
    assert (blind > 1.05 * sigma).all()


def test_without_noise_a_markers_spread_is_its_mean_square():
    rng = np.random.default_rng(4)
    points, error = rng.normal(size=(30, 4, 3)), 0.006 * rng.normal(size=(30, 4, 3))
    # Errors are small beside the robust scale: its weights are near 1.
    found = marker_sigma(PositionTerm(points + error, np.full((30, 4), 1e-2)), points, np.zeros((30, 4, 3, 3)))
    square = (error**2).sum((0, 2)) / 3 + PRIOR_FRAMES * SIGMA_M**2
    assert found == pytest.approx(np.sqrt(square / (30 + PRIOR_FRAMES)), rel=1e-6)


def test_what_is_known_of_a_point_goes_with_it_to_another_label():
    rng = np.random.default_rng(5)
    positions, residual = rng.normal(size=(6, 4, 3)), rng.random((6, 4))
    covariance = rng.random((6, 4, 3, 3))
    cloud = MarkerCloud(positions, FPS, ("A", "B", "C", "D"), residual, covariance)
    points = positions.copy()
    points[2:4, [0, 3]] = points[2:4, [3, 0]]
    points[5, 1] = np.nan
    moved = moved_points(cloud, points)
    assert moved.covariance is not None and moved.residual is not None
    np.testing.assert_array_equal(moved.covariance[2:4, 0], covariance[2:4, 3])
    np.testing.assert_array_equal(moved.covariance[2:4, 3], covariance[2:4, 0])
    np.testing.assert_array_equal(moved.residual[2:4, [0, 3]], residual[2:4, [3, 0]])
    np.testing.assert_array_equal(moved.covariance[:, 1:3], covariance[:, 1:3])
