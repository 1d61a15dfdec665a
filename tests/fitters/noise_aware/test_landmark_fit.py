"""Eq. 5.8: its gradient, and what its two stages recover."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from research.baselines.marker_fits import AdaptiveLoss
from solver_backend.body.body import load_body
from solver_backend.body.landmarks import pose_landmarks
from solver_backend.body.markers import marker_landmarks, marker_layout
from solver_backend.fitters.model.subject import FrameStates, Subject
from solver_backend.fitters.recipes.noise_aware import ACCEL_M_S2, LandmarkFit, SteadyLandmarks
from solver_backend.fitters.single_frame import posed
from solver_backend.geometry.rotations import exp_so3
from solver_backend.priors.gaussian_vae import load_vae
from solver_backend.residuals.landmark_loss import FixedVariances, LandmarkLoss, LearnedVariances
from solver_backend.solver.independent_lbfgs import QuasiNewtonSettings

STEPS = QuasiNewtonSettings(300, 1e-9)
BETAS = np.array([0.9, -0.7, 0.4, 0.0, 0.5, 0.0, 0.0, -0.3, 0.0, 0.2])


@pytest.fixture(scope="module")
def fit() -> LandmarkFit:
    """Three people of one shape with exact markers, started a little off."""
    rng, body, prior = np.random.default_rng(0), load_body(), load_vae("rvposer")
    landmarks = marker_landmarks(body, marker_layout("MANIFOLD_53"))
    truth = FrameStates(0.6 * rng.normal(size=(3, 32)), exp_so3(0.5 * rng.normal(size=(3, 3))), rng.normal(size=(3, 3)))
    frames = posed(prior, truth)
    points = pose_landmarks(body, landmarks, BETAS, frames.root, frames.local, frames.transl).points
    start = FrameStates(
        truth.z + 0.2 * rng.normal(size=(3, 32)), exp_so3(0.1 * rng.normal(size=(3, 3))) @ truth.root,
        truth.transl + 0.03 * rng.normal(size=(3, 3)),
    )  # fmt: skip
    seen = rng.random((3, 53)) > 0.1
    subject = replace(Subject.average(body, landmarks, np.zeros(1)), betas=BETAS)
    return LandmarkFit(subject, prior, start, np.where(seen[..., None], points, 0.0), seen)


@pytest.mark.parametrize("loss", [FixedVariances(), LearnedVariances(0.1), AdaptiveLoss(-1.0)], ids=str)
def test_the_gradient_agrees_with_differences(fit: LandmarkFit, loss: LandmarkLoss) -> None:
    rng = np.random.default_rng(1)
    x = fit.unknowns(loss)
    x = x + 0.1 * rng.normal(size=x.shape)
    gradient, step = fit.evaluate(x, loss)[1], 1e-6
    for column in range(x.shape[1]):
        moved = step * (np.arange(x.shape[1]) == column)
        slope = (fit.evaluate(x + moved, loss)[0] - fit.evaluate(x - moved, loss)[0]) / (2 * step)
        np.testing.assert_allclose(gradient[:, column], slope, rtol=2e-5, atol=2e-3)


def test_the_temporal_term_bends_across_blocks_and_not_across_gaps() -> None:
    rng = np.random.default_rng(2)
    points = rng.normal(size=(6, 4, 3))
    bend = points[:-2] - 2.0 * points[1:-1] + points[2:]
    whole = SteadyLandmarks.of(np.arange(6), 60.0, points[:0], np.arange(0))
    weight = (60.0**2 / ACCEL_M_S2) ** 2
    assert np.isclose(whole(points)[0].sum(), 0.5 * weight * (bend**2).sum())
    later = SteadyLandmarks.of(np.arange(2, 6), 60.0, points[:2], np.arange(2))
    assert np.isclose(later(points[2:])[0].sum(), 0.5 * weight * (bend**2).sum() - whole(points)[0][0])
    torn = SteadyLandmarks.of(np.array([0, 1, 2, 9, 10, 11]), 60.0, points[:0], np.arange(0))
    assert np.isclose(torn(points)[0].sum(), 0.5 * weight * (bend[[0, 3]] ** 2).sum())
    for term, n in ((whole, 0), (later, 2)):
        own, step, slopes = points[n:], 1e-6, np.zeros_like(points[n:])
        for at in np.ndindex(own.shape):
            moved = np.zeros_like(own)
            moved[at] = step
            slopes[at] = (term(own + moved)[0].sum() - term(own - moved)[0].sum()) / (2 * step)
        np.testing.assert_allclose(term(own)[1], slopes, rtol=1e-5, atol=1e-1)


def test_the_derivative_by_the_shape_agrees_with_differences(fit: LandmarkFit) -> None:
    x, step = fit.unknowns(FixedVariances()), 1e-6
    by_betas = fit.evaluate(x, FixedVariances())[2]
    for k in range(10):
        costs = [
            replace(fit, subject=replace(fit.subject, betas=BETAS + sign * step * (np.arange(10) == k)))
            .evaluate(x, FixedVariances())[0]
            for sign in (1, -1)
        ]  # fmt: skip
        np.testing.assert_allclose(by_betas[:, k], (costs[0] - costs[1]) / (2 * step), rtol=1e-5, atol=1e-3)


def distance_mm(fit: LandmarkFit, found: FrameStates) -> np.ndarray:
    frames, subject = posed(fit.prior, found), fit.subject
    points = pose_landmarks(
        subject.body, subject.landmarks, subject.betas, frames.root, frames.local, frames.transl
    ).points
    return 1000 * np.linalg.norm(points - fit.points, axis=-1)


@pytest.mark.slow
def test_exact_markers_are_met_by_pose_and_shape_together(fit: LandmarkFit) -> None:
    unknown = replace(fit, subject=replace(fit.subject, betas=np.zeros(10)))
    subject, found = unknown.fit_shape(FixedVariances(), STEPS)
    assert distance_mm(replace(fit, subject=subject), found)[fit.seen].mean() < 3.0
    assert np.abs(subject.betas - BETAS)[:2].max() < 0.35


@pytest.mark.slow
def test_learned_variances_leave_ghosts_behind_where_least_squares_follows_them(fit: LandmarkFit) -> None:
    ghosts = fit.points.copy()
    ghosts[:, :6] += [0.2, 0.1, -0.15]
    spoilt = replace(fit, points=ghosts)
    coarse, _ = spoilt.fit_poses(FixedVariances(), STEPS)
    fine, _ = replace(spoilt, start=coarse).fit_poses(LearnedVariances(0.1), STEPS)
    kept = fit.seen & (np.arange(53) >= 6)
    least_squares, learned = (distance_mm(fit, found)[kept].mean() for found in (coarse, fine))
    assert learned < 0.4 * least_squares


def test_frames_do_not_notice_each_other(fit: LandmarkFit) -> None:
    together, _ = fit.fit_poses(LearnedVariances(0.1), QuasiNewtonSettings(20))
    for f in range(3):
        alone, _ = fit.select(slice(f, f + 1)).fit_poses(LearnedVariances(0.1), QuasiNewtonSettings(20))
        np.testing.assert_allclose(alone.transl[0], together.transl[f], atol=1e-4)
