"""Reprojection errors of points that were moved by a known number of pixels."""

from __future__ import annotations

import numpy as np
import pytest

from solver_backend.exchange.errors import ShapeMismatch
from solver_backend.metrics import reprojection_px
from solver_backend.types import Cameras, JointSet, Keypoints2D

COUNT = JointSet.COCO_17.num_keypoints


def scene() -> tuple[Cameras, np.ndarray, Keypoints2D]:
    """Two pinhole cameras 4 m from points near the origin, with detections 5 px off."""
    K = np.array([[1000.0, 0.0, 500.0], [0.0, 1000.0, 400.0], [0.0, 0.0, 1.0]])
    R = np.stack([np.eye(3), [[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]])
    cameras = Cameras(
        ("a", "b"), np.stack([K, K]), np.zeros((2, 8)), R, np.tile([0, 0, 4.0], (2, 1)), [[1000, 800]] * 2
    )
    points = np.random.default_rng(0).uniform(-0.5, 0.5, size=(6, COUNT, 3))
    local = np.einsum("cij,fkj->cfki", R, points) + [0, 0, 4.0]
    xy = 1000.0 * local[..., :2] / local[..., 2:] + [500.0, 400.0]
    keypoints = Keypoints2D(xy + [3.0, -4.0], np.ones(xy.shape[:3]), JointSet.COCO_17, 30.0)
    return cameras, points, keypoints


def test_the_error_is_the_distance_in_pixels():
    cameras, points, keypoints = scene()
    np.testing.assert_allclose(reprojection_px(cameras, points, keypoints), 5.0, atol=1e-9)


def test_unseen_and_unsolved_points_are_nan():
    cameras, points, keypoints = scene()
    confidence = keypoints.confidence.copy()
    confidence[0, 2] = 0.0
    points[4, 1] = np.nan
    error = reprojection_px(cameras, points, Keypoints2D(keypoints.xy, confidence, JointSet.COCO_17, 30.0))
    assert np.isnan(error).sum() == COUNT + 2


def test_points_and_cameras_must_fit_the_detections():
    cameras, points, keypoints = scene()
    with pytest.raises(ShapeMismatch, match=r"points has shape \(1, 17, 3\), but \(6, 17, 3\) is expected"):
        reprojection_px(cameras, points[:1], keypoints)
    with pytest.raises(ShapeMismatch, match=r"translation has shape \(1, 3\), but \(2, 3\) is expected"):
        reprojection_px(cameras.subset([0]), points, keypoints)
