"""Rotations, distortion and skinning against their definitions and against the solver's own code."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from blender_addon._exchange.lens import distort, normalised, pixels, undistort
from blender_addon._exchange.so3 import matrix_from_rotvec, quat_from_rotvec, quat_multiply, sign_continuous
from blender_addon.body.posed_body import pose_joints, skin

_RNG = np.random.default_rng(11)
_ROTVECS = np.concatenate([_RNG.normal(size=(50, 3)) * 2, np.zeros((1, 3)), [[1e-9, 0, 0], [np.pi, 0, 0]]])


def _matrix_from_quat(q: np.ndarray) -> np.ndarray:
    w, x, y, z = np.moveaxis(q, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def test_quaternion_and_matrix_are_one_rotation() -> None:
    R = matrix_from_rotvec(_ROTVECS)
    np.testing.assert_allclose(R, _matrix_from_quat(quat_from_rotvec(_ROTVECS)), atol=1e-14)
    np.testing.assert_allclose(R @ R.transpose(0, 2, 1), np.broadcast_to(np.eye(3), R.shape), atol=1e-14)
    np.testing.assert_allclose((R @ _ROTVECS[..., None])[..., 0], _ROTVECS, atol=1e-12)


def test_quaternion_product_is_the_matrix_product() -> None:
    a, b = quat_from_rotvec(_ROTVECS), quat_from_rotvec(_ROTVECS[::-1])
    expected = _matrix_from_quat(a) @ _matrix_from_quat(b)
    np.testing.assert_allclose(_matrix_from_quat(quat_multiply(a, b)), expected, atol=1e-14)


def test_sign_continuous_keeps_rotations_and_joins_neighbours() -> None:
    angle = np.linspace(0, 9 * np.pi, 200)
    quat = quat_from_rotvec(np.stack([0 * angle, angle, 0 * angle], -1)[:, None])
    broken = quat * _RNG.choice([-1.0, 1.0], size=(200, 1, 1))
    joined = sign_continuous(broken)
    assert ((joined[1:] * joined[:-1]).sum(-1) > 0).all() and joined[0, 0, 0] >= 0
    np.testing.assert_allclose(_matrix_from_quat(joined), _matrix_from_quat(quat), atol=1e-14)


@pytest.mark.parametrize(
    ("model", "coefficients"),
    [
        ("opencv", [-0.28, 0.11, 0.001, -0.0007, -0.02, 0, 0, 0]),
        ("opencv", [0.9, 0.2, 0.0005, 0.001, 0.01, 1.1, 0.4, 0.03]),
        ("fisheye", [0.05, -0.01, 0.004, -0.001, 0, 0, 0, 0]),
    ],
)
def test_undistort_inverts_distort_and_distort_is_the_solvers(model: str, coefficients: list[float]) -> None:
    k = np.array(coefficients)
    points = _RNG.uniform(-0.55, 0.55, size=(300, 2))
    points[0] = 0
    bent = distort(points, k, model)
    bent[7] = np.nan
    back = undistort(bent, k, model)
    assert np.isnan(back[7]).all()
    np.testing.assert_allclose(np.delete(back, 7, 0), np.delete(points, 7, 0), atol=1e-9)
    from solver_backend.cameras.projection import project

    K = np.array([[1000.0, 0, 950.5], [0, 1010.0, 540.25], [0, 0, 1]])
    world = np.concatenate([points, np.ones((300, 1))], axis=-1)
    expected = project(K[None], k[None], np.eye(3)[None], np.zeros((1, 3)), world, model)[0]
    np.testing.assert_allclose(pixels(distort(points, k, model), K), expected, atol=1e-9)


def test_undistort_of_points_beyond_the_lens_is_nan() -> None:
    assert np.isnan(undistort(np.array([[3.0, 3.0]]), np.array([-0.3, 0, 0, 0, 0, 0, 0, 0]), "opencv")).all()


def test_pixels_inverts_normalised() -> None:
    K = np.array([[900.0, 2.5, 640.0], [0, 950.0, 360.0], [0, 0, 1]])
    uv = _RNG.uniform(0, 1000, size=(20, 2))
    np.testing.assert_allclose(pixels(normalised(uv, K), K), uv, atol=1e-10)


def test_posed_joints_are_the_solvers(files: Any) -> None:
    from solver_backend.body.body import load_body
    from solver_backend.body.kinematics import forward_kinematics

    motion = files.motion
    G, joints = pose_joints(files.body.rest_joints(motion.betas), motion.rotvec, motion.transl)
    R = matrix_from_rotvec(motion.rotvec)
    expected = forward_kinematics(load_body(files.body_path), motion.betas, R[:, 0], R[:, 1:], motion.transl)
    np.testing.assert_allclose(joints, expected.joints, atol=1e-12)
    np.testing.assert_allclose(G, expected.G, atol=1e-12)


def test_skin_moves_rigidly_with_the_root(files: Any) -> None:
    """Every vertex of a body that only turns and moves is turned and moved, correctives or not."""
    from dataclasses import replace

    still = replace(files.motion, rotvec=np.zeros((2, 24, 3)), transl=np.zeros((2, 3)))
    turn, shift = np.array([0.3, -1.0, 0.5]), np.array([1.0, 2.0, 3.0])
    rotvec = np.zeros((2, 24, 3))
    rotvec[1, 0] = turn
    moved = replace(still, rotvec=rotvec, transl=np.stack([np.zeros(3), shift]))
    rest = skin(files.body, still, [0])[0]
    np.testing.assert_allclose(rest, files.body.shaped(still.betas), atol=1e-12)
    pelvis = files.body.rest_joints(still.betas)[0]
    expected = (rest - pelvis) @ matrix_from_rotvec(turn).T + pelvis + shift
    np.testing.assert_allclose(skin(files.body, moved, [1])[0], expected, atol=1e-12)
