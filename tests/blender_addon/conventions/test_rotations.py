"""Rotations against their definitions."""

from __future__ import annotations

import numpy as np

from blender_addon._exchange.so3 import matrix_from_rotvec, quat_from_rotvec, quat_multiply, sign_continuous

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
