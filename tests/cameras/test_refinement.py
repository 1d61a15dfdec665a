"""Cameras that were turned are turned back by the person they film."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver_backend.cameras.projection import project
from solver_backend.cameras.refinement import refined_cameras, resected
from solver_backend.cameras.robust_triangulation import triangulate
from solver_backend.geometry.rotations import exp_so3
from solver_backend.synthesis.embedded.demo import tripods
from solver_backend.types import Cameras


def _scene(noise_px: float = 0.0) -> tuple[Cameras, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(2)
    cameras = tripods(np.array([0.0, 0.0, 0.95]))
    points = rng.uniform(-0.5, 0.5, (40, 12, 3)) + [0.0, 0.0, 0.95]
    px = project(cameras, points)
    return cameras, points, px + noise_px * rng.normal(size=px.shape)


def _turned(cameras: Cameras, view: int, degrees: float) -> Cameras:
    turn = np.tile(np.eye(3), (len(cameras), 1, 1))
    turn[view] = exp_so3(np.radians(degrees) * np.array([0.6, -0.8, 0.0]))
    return replace(cameras, R=turn @ cameras.R, t=(turn @ cameras.t[..., None])[..., 0])


def test_a_camera_is_found_from_points_that_are_known() -> None:
    cameras, points, px = _scene()
    found = resected(_turned(cameras, 2, 3.0), px, np.ones(px.shape[:-1]), points, scale_px=200.0, steps=10)
    assert np.abs(found.R - cameras.R).max() < 1e-9
    assert np.abs(found.t - cameras.t).max() < 1e-9


def test_detections_alone_turn_a_camera_back() -> None:
    cameras, _, px = _scene(noise_px=2.0)
    given = _turned(cameras, 1, 0.4)
    found = refined_cameras(given, px, np.ones(px.shape[:-1]))

    def disagreement(rig: Cameras) -> float:
        return float(np.nanmedian(triangulate(rig, px, np.ones(px.shape[:-1])).residual_px))

    assert disagreement(given) > 2.5
    assert disagreement(found) < 1.03 * disagreement(cameras) < 2.1


def test_a_camera_that_sees_one_place_alone_stays() -> None:
    cameras = replace(
        tripods(np.zeros(3)),
        R=np.tile(np.eye(3), (4, 1, 1)),
        t=np.tile([0.0, 0.0, 2.0], (4, 1)),
        distortion=np.zeros((4, 8)),
    )
    points = np.zeros((40, 12, 3))
    px = project(cameras, points)
    found = resected(cameras, px, np.ones(px.shape[:-1]), points, scale_px=1.0)
    np.testing.assert_allclose(found.R, cameras.R, atol=1e-9)
    np.testing.assert_allclose(found.t, cameras.t, atol=1e-9)


def test_missing_detections_take_no_part() -> None:
    cameras, points, px = _scene()
    confidence = np.ones(px.shape[:-1])
    px[0, :20], confidence[0, :20] = np.nan, 0.0
    found = resected(_turned(cameras, 0, 1.0), px, confidence, points, scale_px=100.0)
    assert np.abs(found.R - cameras.R).max() < 1e-6
