"""Data terms: gradients against central differences, weights that act as they should."""

import numpy as np
import pytest

from solver_backend.residuals.positions import PositionTerm
from solver_backend.residuals.reprojection import ReprojectionTerm
from solver_backend.residuals.terms import geman_mcclure, graduated_scales
from solver_backend.types import Keypoints2D
from tests.support.filmed_points import POINTS, reprojection


def check_gradient(term, points, scale):
    evidence = term(points, scale)
    rng = np.random.default_rng(1)
    for _ in range(8):
        d = rng.normal(size=points.shape)
        numeric = (term(points + 1e-6 * d, scale).cost - term(points - 1e-6 * d, scale).cost) / 2e-6
        analytic = (evidence.gradient * d).sum((1, 2))
        np.testing.assert_allclose(analytic, numeric, rtol=1e-6, atol=1e-6 * np.abs(numeric).max())


@pytest.mark.parametrize("scale", [1e4, 2.0])
def test_gradient_of_reprojection(scale):
    cameras, keypoints, points = reprojection()
    check_gradient(ReprojectionTerm.of(cameras, keypoints, np.full(POINTS, 5.0), points), points, scale)


def test_gradient_of_positions():
    _, _, points = reprojection()
    rng = np.random.default_rng(2)
    term = PositionTerm(points + 0.05 * rng.normal(size=points.shape), rng.uniform(0, 900, points.shape[:2]))
    check_gradient(term, points, 3.0)


def test_whitened_positions_weigh_errors_by_their_covariance():
    _, _, points = reprojection()
    rng = np.random.default_rng(2)
    shape = rng.normal(size=(*points.shape, 3))
    covariance = 1e-3 * (shape @ shape.swapaxes(-1, -2) + 0.1 * np.eye(3))
    measured = points + 0.05 * rng.normal(size=points.shape)
    term = PositionTerm.of(measured, covariance, points)
    check_gradient(term, points, 3.0)
    information = term(measured, 3.0).information
    np.testing.assert_allclose(information @ covariance, np.broadcast_to(np.eye(3), covariance.shape), atol=1e-8)
    error = points - measured
    squared = np.einsum("fli,flij,flj->fl", error, np.linalg.inv(covariance), error)
    np.testing.assert_allclose(term.residuals(points).squared[0], squared, rtol=1e-8)


def test_noise_alike_in_all_directions_is_the_plain_term():
    _, _, points = reprojection()
    measured = points + 0.01
    plain = PositionTerm(measured, np.full(points.shape[:2], 2500.0))(points, 3.0)
    whole = PositionTerm.of(measured, np.full((*points.shape, 3), 4e-4) * np.eye(3), points)(points, 3.0)
    for name in ("cost", "gradient", "information"):
        np.testing.assert_allclose(getattr(whole, name), getattr(plain, name), rtol=1e-12, atol=1e-9)


def test_information_is_the_hessian_at_zero_residual():
    cameras, keypoints, points = reprojection()
    from solver_backend.cameras.projection import project

    exact = project(cameras, points)
    keypoints = Keypoints2D(exact, keypoints.confidence, keypoints.joint_set, 60.0)
    term = ReprojectionTerm.of(cameras, keypoints, np.full(POINTS, 5.0), points)
    information = term(points, 3.0).information
    for axis in range(3):
        d = np.zeros(3)
        d[axis] = 1e-5
        column = (term(points + d, 3.0).gradient - term(points - d, 3.0).gradient) / 2e-5
        np.testing.assert_allclose(information[..., axis], column, rtol=2e-4, atol=1e-4 * np.abs(information).max())


def test_missing_detections_carry_no_information():
    cameras, keypoints, points = reprojection()
    blind = Keypoints2D(keypoints.xy, 0 * keypoints.confidence, keypoints.joint_set, 60.0)
    evidence = ReprojectionTerm.of(cameras, blind, np.full(POINTS, 5.0), points)(points, 3.0)
    assert evidence.cost.sum() == 0 and np.abs(evidence.gradient).sum() == 0 and np.abs(evidence.information).sum() == 0


def test_torch_equals_numpy():
    torch = pytest.importorskip("torch")
    cameras, keypoints, points = reprojection()
    one = ReprojectionTerm.of(cameras, keypoints, np.full(POINTS, 5.0), points)(points, 2.0)
    tensor = torch.as_tensor(points)
    other = ReprojectionTerm.of(cameras, keypoints, np.full(POINTS, 5.0), tensor)(tensor, 2.0)
    for name in ("cost", "gradient", "information"):
        np.testing.assert_allclose(getattr(other, name).numpy(), getattr(one, name), rtol=1e-10, atol=1e-8)


def test_geman_mcclure_forgets_outliers_and_keeps_inliers():
    penalty, weight = geman_mcclure(np.array([0.0, 1e-4, 1e6]), 3.0)
    np.testing.assert_allclose(weight[:2], 1.0, atol=1e-4)
    assert weight[2] < 1e-9 and penalty[2] == pytest.approx(9.0, rel=1e-4)
    assert graduated_scales(3.0, 12.0, 3) == pytest.approx((12.0, 6.0, 3.0))


def test_a_point_behind_a_camera_is_no_better_than_an_outlier():
    cameras, keypoints, points = reprojection()
    term = ReprojectionTerm.of(cameras, keypoints, np.full(POINTS, 5.0), points)
    behind = cameras.centres[0] * 1.5
    assert (term(np.broadcast_to(behind, points.shape).copy(), 3.0).cost >= term(points, 3.0).cost).all()


def test_pose_mixture_gradient_and_curvature():
    from solver_backend.geometry.rotations import exp_so3
    from solver_backend.residuals.pose_mixture import PoseMixtureTerm

    rng = np.random.default_rng(0)
    local = exp_so3(0.3 * rng.normal(size=(4, 21, 3)))
    term = PoseMixtureTerm()
    evidence = term(local)
    gradient, hessian = evidence.gradient, term.hessian(evidence.factors)
    np.testing.assert_allclose(hessian, np.swapaxes(hessian, 1, 2), atol=1e-9)
    assert (np.linalg.eigvalsh(hessian) > 0).all()
    for _ in range(5):
        d = rng.normal(size=(4, 21, 3))
        costs = [term(exp_so3(s * 1e-6 * d) @ local).cost for s in (1, -1)]
        np.testing.assert_allclose((gradient * d.reshape(4, -1)).sum(1), (costs[0] - costs[1]) / 2e-6, rtol=1e-5)


def test_bent_hips_come_with_a_bent_spine():
    """What the mixture is there for: of two ways to lean forward that no keypoint tells apart, the usual one."""
    from solver_backend.geometry.rotations import exp_so3
    from solver_backend.residuals.pose_mixture import PoseMixtureTerm
    from solver_backend.types import SMPL_JOINTS

    def crouched(spine: float, hips: float) -> np.ndarray:
        vectors = np.zeros((1, 21, 3))
        for joint, angle in (
            ("spine1", spine),
            ("left_hip", -hips),
            ("right_hip", -hips),
            ("left_knee", 1.0),
            ("right_knee", 1.0),
        ):
            vectors[0, SMPL_JOINTS.index(joint) - 1, 0] = angle
        return PoseMixtureTerm()(exp_so3(vectors)).cost

    assert crouched(0.4, 0.8) < crouched(-0.4, 1.6)
