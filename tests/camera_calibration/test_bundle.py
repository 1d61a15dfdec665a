"""Bundle adjustment: derivatives, known truths, what it says of its own errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solver_backend.camera_calibration.adjustment.bundle import (
    CAMERA_PARAMETERS,
    Bodies,
    BodySightings,
    Unknowns,
    adjust,
    median_by_camera,
)
from solver_backend.camera_calibration.adjustment.lens import moved, project_local
from solver_backend.geometry.alignment import umeyama
from solver_backend.geometry.rotations import exp_so3
from tests.support.carried_board import ring


@pytest.mark.parametrize("model", ["opencv", "fisheye"])
def test_the_projections_derivatives_are_finite_differences(model: str) -> None:
    rng = np.random.default_rng(0)
    cameras = ring(3, model, lens=rng.normal(0, 0.02, 8) * ([1] * 4 + [model == "opencv"] * 4))
    which = np.repeat(np.arange(3), 30)
    x = rng.normal(0, 0.5, (90, 3)) + [0, 0, 3]
    _, by_point, by_lens = project_local(cameras, which, x)
    step = 1e-6
    for i, e in enumerate(step * np.eye(3)):
        numeric = (project_local(cameras, which, x + e)[0] - project_local(cameras, which, x - e)[0]) / (2 * step)
        assert np.abs(numeric - by_point[..., i]).max() < 1e-5
    for i in range(12 if model == "opencv" else 8):
        e = np.zeros((3, 12))
        e[:, i] = step
        there, back = (project_local(moved(cameras, s * e), which, x)[0] for s in (1, -1))
        assert np.abs((there - back) / (2 * step) - by_lens[..., i]).max() < 1e-4


def filmed(seed: int, noise_px: float) -> tuple:
    rng = np.random.default_rng(seed)
    cameras = ring(4)
    X = rng.normal(0, 0.5, (200, 3))
    camera, body = np.repeat(np.arange(4), 200), np.tile(np.arange(200), 4)
    x_cam = (cameras.R[camera] @ X[body][..., None])[..., 0] + cameras.t[camera]
    px = project_local(cameras, camera, x_cam)[0] + rng.normal(0, noise_px, (800, 2))
    return cameras, X, BodySightings(camera, body, np.zeros((800, 3)), px, np.full(800, max(noise_px, 0.1)))


def shaken(cameras, rng):
    R = exp_so3(rng.normal(0, 0.03, (len(cameras), 3))) @ cameras.R
    return replace(cameras, R=R, t=cameras.t + rng.normal(0, 0.05, cameras.t.shape))


ALL = Unknowns(np.ones(4, bool), np.zeros((4, 12), bool))
STILL = np.tile(np.eye(3), (200, 1, 1))


def test_points_and_cameras_are_recovered_without_noise() -> None:
    cameras, X, seen = filmed(0, 0.0)
    rng = np.random.default_rng(1)
    found = adjust(shaken(cameras, rng), Bodies(STILL, X + rng.normal(0, 0.05, X.shape)), seen, ALL, gauge=7)
    assert found.rmse_px < 1e-5
    s, R, t = umeyama(found.cameras.centres, cameras.centres, with_scale=True)
    assert np.abs(s * found.cameras.centres @ R.T + t - cameras.centres).max() < 1e-6


def test_outliers_do_not_move_the_cameras() -> None:
    cameras, X, seen = filmed(0, 0.3)
    rng = np.random.default_rng(2)
    px = seen.px.copy()
    px[rng.random(800) < 0.1] += rng.normal(0, 150, 2)
    errors = []
    for sightings in (seen, replace(seen, px=px)):
        found = adjust(shaken(cameras, rng), Bodies(STILL, X), sightings, ALL, gauge=7)
        s, R, t = umeyama(found.cameras.centres, cameras.centres, with_scale=True)
        errors.append(np.linalg.norm(s * found.cameras.centres @ R.T + t - cameras.centres, axis=1).max())
    assert errors[0] < 0.003
    assert errors[1] < 0.004


def test_the_covariance_is_the_spread_over_repeated_noise(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("solver_backend.camera_calibration.adjustment.bundle.PLACE_SIGMA_M", 1e-4)
    known = np.full((200, 3), np.nan)
    focal = []
    for seed in range(24):
        cameras, X, seen = filmed(0, 0.0)
        rng = np.random.default_rng(seed)
        noisy = replace(seen, px=seen.px + rng.normal(0, 0.5, seen.px.shape), sigma=np.full(800, 0.5))
        known = X + 0.0
        lens = np.zeros((4, 12), bool)
        lens[:, :2] = True
        found = adjust(
            cameras, Bodies(STILL, X, known), noisy, Unknowns(np.ones(4, bool), lens), gauge=0, robust_scale=50.0
        )
        focal.append(np.log(found.cameras.K[:, 0, 0] / cameras.K[:, 0, 0]))
    told = np.sqrt(np.diag(found.covariance)).reshape(4, CAMERA_PARAMETERS)[:, 6]
    assert np.abs(np.std(focal, axis=0) / told - 1).max() < 0.45


def test_one_focal_length_stays_one() -> None:
    cameras, X, seen = filmed(3, 0.2)
    lens = np.zeros((4, 12), bool)
    lens[:, :2] = True
    wrong = replace(cameras, K=cameras.K * np.array([[1.05, 1, 1], [1, 1.05, 1], [1, 1, 1]]))
    sigma = np.full((4, 12), 1.0)
    found = adjust(wrong, Bodies(STILL, X), seen, Unknowns(np.ones(4, bool), lens, sigma), gauge=7)
    K = found.cameras.K
    assert np.abs(K[:, 0, 0] - K[:, 1, 1]).max() < 1e-9
    assert np.abs(K[:, 0, 0] / cameras.K[:, 0, 0] - 1).max() < 0.01


def test_the_median_of_a_camera_leaves_out_points_behind_it() -> None:
    camera = np.array([0, 0, 0, 1, 1])
    seen = BodySightings(camera, np.arange(5), np.zeros((5, 3)), np.zeros((5, 2)), np.ones(5))
    far = np.array([1.0, 3.0, np.nan, np.nan, np.nan])
    np.testing.assert_array_equal(median_by_camera(far, seen, 3), [2.0, np.nan, np.nan])
