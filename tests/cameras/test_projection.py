"""Projection: derivatives, exact inverse, what is not visible is NaN, OpenCV's own numbers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from solver_backend.cameras import projection
from solver_backend.cameras.projection import distort, distorted, largest_radius, undistort_normalised
from solver_backend.exchange.errors import CalibrationInvalid
from solver_backend.geometry.rotations import exp_so3
from solver_backend.types import Cameras

LENSES = {
    "none": ("opencv", [0.0] * 8),
    "barrel": ("opencv", [-0.28, 0.07, 1e-3, -5e-4, 0.01, 0, 0, 0]),
    "pincushion": ("opencv", [0.2, 0.05, -1e-3, 2e-3, 0, 0, 0, 0]),
    "rational": ("opencv", [5.2, 1.3, 2e-4, -3e-4, 0.03, 5.5, 3.1, 0.3]),
    "fisheye": ("fisheye", [-0.02, 0.01, -0.006, 0.001, 0, 0, 0, 0]),
}


def rig(lens: str, count: int = 3) -> Cameras:
    """Return cameras 3 m from the origin, looking at it, with this lens."""
    model, coefficients = LENSES[lens]
    rng = np.random.default_rng(3)
    K = np.tile([[900.0, 1.5, 640], [0, 905, 360], [0, 0, 1]], (count, 1, 1)) + np.arange(count)[:, None, None] * 0.01
    K[:, 1:, 0] = K[:, 2, 1] = 0.0
    K[:, 2, 2] = 1.0
    R = exp_so3(rng.normal(size=(count, 3)))
    distortion = np.tile(coefficients, (count, 1)) * (1 + 0.05 * np.arange(count)[:, None])
    names = tuple("abcdefgh"[:count])
    return Cameras(
        names, K, distortion, R, np.tile([0.1, -0.2, 3.0], (count, 1)), np.tile([1280, 720], (count, 1)), (model,)
    )


@pytest.mark.parametrize("lens", LENSES)
def test_jacobian_equals_central_differences(lens):
    cameras = rig(lens)
    points = np.random.default_rng(0).uniform(-0.7, 0.7, (4, 5, 3))
    px, J, depth = projection.project_with_jacobian(cameras, points)
    assert px.shape == (3, 4, 5, 2) and J.shape == (3, 4, 5, 2, 3) and depth.shape == (3, 4, 5)
    assert np.isfinite(px).all()
    h = 1e-4
    for i, e in enumerate(np.eye(3)):

        def at(offset, e=e):
            return projection.project(cameras, points + offset * e)

        numeric = (8 * (at(h) - at(-h)) - (at(2 * h) - at(-2 * h))) / (12 * h)
        np.testing.assert_allclose(J[..., i], numeric, rtol=1e-7, atol=1e-6)
    np.testing.assert_array_equal(px, at(0.0))
    camera = np.einsum("cij,fkj->cfki", cameras.R, points) + cameras.t[:, None, None]
    np.testing.assert_allclose(depth, camera[..., 2], atol=1e-14)


@pytest.mark.parametrize("lens", LENSES)
def test_undistort_inverts_the_lens_over_the_whole_image(lens):
    cameras = rig(lens)
    u, v = np.meshgrid(np.linspace(0, 1279, 41), np.linspace(0, 719, 23))
    xy = np.broadcast_to(np.stack([u, v], -1), (3, 23, 41, 2))
    n = projection.undistort(cameras, xy)
    assert np.isfinite(n).all()
    depth = np.linspace(0.5, 6.0, 41)[:, None]
    camera = np.concatenate([n, np.ones_like(n[..., :1])], -1) * depth
    for c in range(3):
        world = (camera[c] - cameras.t[c]) @ cameras.R[c]
        back = projection.project(cameras, world)[c]
        np.testing.assert_allclose(back, xy[c], atol=1e-9)


@pytest.mark.parametrize("lens", LENSES)
def test_undistorted_pixels_point_to_what_was_projected(lens):
    cameras = rig(lens)
    points = np.random.default_rng(1).uniform(-0.7, 0.7, (6, 3))
    px = projection.project(cameras, points)
    found = projection.undistort(cameras, px)
    local = points @ np.swapaxes(cameras.R, -1, -2) + cameras.t[:, None]
    np.testing.assert_allclose(found, local[..., :2] / local[..., 2:], atol=1e-12)
    missing = np.full_like(px, np.nan)
    assert np.isnan(projection.undistort(cameras, missing)).all()


def test_points_behind_a_camera_and_missing_points_are_nan():
    cameras = rig("barrel", 1)
    towards = cameras.R[0][2]
    points = cameras.centres + np.array([[-1.0], [0.0], [0.005], [1.0]]) * towards
    points = np.concatenate([points, np.full((1, 3), np.nan)])
    px, J, depth = projection.project_with_jacobian(cameras, points)
    np.testing.assert_array_equal(np.isfinite(px[0]).all(-1), [False, False, False, True, False])
    np.testing.assert_array_equal(np.isfinite(J[0]).all((-1, -2)), [False, False, False, True, False])
    np.testing.assert_allclose(depth[0, :4], [-1, 0, 0.005, 1.0], atol=1e-14)
    np.testing.assert_array_equal(np.isnan(projection.project(cameras, points)), np.isnan(px))


def test_nothing_folds_back_into_the_image():
    """With k1 = -0.3 the lens turns at r = 1.054: pixels grow up to there and are NaN beyond."""
    distortion = np.array([[-0.3, 0, 0, 0, 0, 0, 0, 0.0]])
    limit = largest_radius(distortion, ("opencv",))
    np.testing.assert_allclose(limit, [np.sqrt(1 / 0.9)], rtol=1e-4)
    camera = projection.CameraArrays(np.eye(3)[None] * 800, distortion, np.eye(3)[None], np.zeros((1, 3)), ("opencv",))
    r = np.linspace(0, 3, 301)
    points = np.stack([r, 0 * r, 0 * r + 1], -1)
    px = projection.project(camera, points)[0, :, 0]
    seen = r <= limit
    np.testing.assert_array_equal(np.isfinite(px), seen)
    assert (np.diff(px[seen]) > 0).all()
    top = limit * (1 - 0.3 * limit**2)
    outside = np.stack([top * [1.001, 0.999, -1.1], np.zeros(3)], -1)[None]
    found = undistort_normalised(outside, distortion, ("opencv",))
    np.testing.assert_array_equal(np.isfinite(found).all(-1), [[False, True, False]])


@pytest.mark.parametrize("lens", LENSES)
def test_largest_radius_is_where_the_slope_ends(lens):
    model, coefficients = LENSES[lens]
    distortion = np.array([coefficients])
    limit = min(float(largest_radius(distortion, (model,))[0]), 50.0)
    xy = np.linspace(0, 0.999 * limit, 4000)[None, :, None] * np.array([1.0, 0.0])
    radial = distortion * [1, 1, 0, 0, 1, 1, 1, 1] if model == "opencv" else distortion
    assert (np.diff(distort(xy, radial, (model,))[0, :, 0]) > 0).all()


@pytest.mark.parametrize("lens", LENSES)
def test_distortion_jacobian(lens):
    model, coefficients = LENSES[lens]
    distortion, h = np.array([coefficients]), 1e-4
    xy = np.random.default_rng(2).uniform(-0.6, 0.6, (1, 50, 2))
    xy[0, 0] = 0.0
    _, _, (xx, cross, yy) = distorted(xy[..., 0], xy[..., 1], distortion, (model,))
    analytic = np.stack([np.stack([xx, cross], -1), np.stack([cross, yy], -1)], -1)
    for i, e in enumerate(np.eye(2)):

        def at(offset, e=e):
            return distort(xy + offset * e, distortion, (model,))

        numeric = (8 * (at(h) - at(-h)) - (at(2 * h) - at(-2 * h))) / (12 * h)
        np.testing.assert_allclose(analytic[..., i], numeric, atol=1e-9)


@pytest.mark.parametrize("lens", LENSES)
def test_torch_equals_numpy(lens):
    cameras = rig(lens)
    points = np.random.default_rng(0).uniform(-4, 4, (200, 3))
    expected = projection.project_with_jacobian(cameras, points)
    assert np.isnan(expected[0]).any()
    for dtype, rtol in ((torch.float64, 1e-12), (torch.float32, 1e-3)):
        tensor = torch.as_tensor(points).to(dtype)
        found = projection.project_with_jacobian(projection.CameraArrays.of(cameras, tensor), tensor)
        for x, y in zip(found, expected, strict=True):
            assert x.dtype == dtype
            np.testing.assert_allclose(x.numpy(), y, rtol=rtol, atol=rtol * 1000)
    px = expected[0]
    n = projection.undistort(cameras, px)
    tensor = torch.as_tensor(px)
    of_torch = projection.CameraArrays.of(cameras, tensor)
    np.testing.assert_allclose(projection.undistort(of_torch, tensor).numpy(), n, atol=1e-11)
    single = projection.undistort(of_torch.astype(torch.float32), tensor.to(torch.float32))
    close = np.isfinite(single.numpy()) & (np.abs(n) < 2)
    assert close[np.isfinite(n) & (np.abs(n) < 1)].mean() > 0.99
    np.testing.assert_allclose(single.numpy()[close], n[close], rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("lens", LENSES)
def test_equals_opencv(lens):
    cv2 = pytest.importorskip("cv2", reason="OpenCV is not installed; it is only needed to compare with it")
    cameras = rig(lens, 1)
    points = np.random.default_rng(5).uniform(-0.8, 0.8, (30, 1, 3))
    K, d = cameras.K[0].copy(), cameras.distortion[0]
    K[0, 1] = 0.0
    rotation = cv2.Rodrigues(cameras.R[0])[0]
    if cameras.models == ("fisheye",):
        expected, _ = cv2.fisheye.projectPoints(points, rotation, cameras.t[0].reshape(3, 1), K, d[:4])
    else:
        expected, J = cv2.projectPoints(points, rotation, cameras.t[0], K, d)
    px, ours, _ = projection.project_with_jacobian(replace(cameras, K=K[None]), points[:, 0])
    np.testing.assert_allclose(px[0], expected[:, 0], atol=1e-9)
    if cameras.models == ("opencv",):
        by_translation = J[:, 3:6].reshape(-1, 2, 3)
        np.testing.assert_allclose(ours[0], by_translation @ cameras.R[0], atol=1e-8)


def test_an_unknown_model_is_named():
    with pytest.raises(CalibrationInvalid, match="Unknown distortion model 'brown'. Known models: opencv, fisheye"):
        replace(rig("none"), models=("brown",))
    unchecked = replace(projection.CameraArrays.of(rig("none"), np.zeros(1)), models=("brown",))
    with pytest.raises(CalibrationInvalid, match="Unknown distortion model 'brown'. Known models: opencv, fisheye"):
        projection.project(unchecked, np.zeros((1, 3)))
