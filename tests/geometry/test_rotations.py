"""Rotations: group axioms near 0 and π, Jacobians against central differences, NumPy against torch."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from solver_backend.geometry import rotations as rot

ANGLES = (0.0, 1e-300, 1e-12, 1e-8, 1e-4, 0.0999, 0.3162, 0.3163, 1.0, 3.0, np.pi - 1e-4, np.pi - 1e-8, np.pi)


def rotvec_grid(angles: tuple[float, ...] = ANGLES) -> np.ndarray:
    axes = np.random.default_rng(0).normal(size=(40, 3))
    axes = np.concatenate([axes, np.eye(3), -np.eye(3), [[1.0, 1.0, 0.0], [1e-9, 1.0, 0.0]]])
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    return np.asarray(angles)[:, None, None] * axes


def central_difference(function, x: np.ndarray, step: float = 1e-5) -> np.ndarray:
    """Return (n_out, n_in) of a function from vector to vector, fourth order."""
    columns = []
    for i in range(x.size):
        d = np.zeros_like(x)
        d[i] = step
        near, far = function(x + d) - function(x - d), function(x + 2 * d) - function(x - 2 * d)
        columns.append((8.0 * near - far) / (12.0 * step))
    return np.stack(columns, axis=-1)


vectors = st.tuples(
    st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda a: np.linalg.norm(a) > 1e-3),
    st.one_of(
        st.floats(0, np.pi), st.sampled_from(ANGLES), st.floats(0, 1e-6), st.floats(0, 1e-6).map(lambda e: np.pi - e)
    ),
).map(lambda p: p[1] * np.asarray(p[0]) / np.linalg.norm(p[0]))


@settings(deadline=None, max_examples=150)
@given(vectors, vectors, vectors)
def test_group_axioms(a, b, c):
    Ra, Rb, Rc = (rot.exp_so3(v) for v in (a, b, c))
    for R in (Ra, Rb, Rc):
        np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-14)
        assert np.linalg.det(R) == pytest.approx(1.0, abs=1e-14)
    np.testing.assert_allclose(rot.exp_so3(-a), Ra.T, atol=1e-15)
    np.testing.assert_allclose(rot.exp_so3(rot.log_so3(Ra @ Rb)), Ra @ Rb, atol=4e-15)
    qa, qb, qc = (rot.quat_from_matrix(R) for R in (Ra, Rb, Rc))
    left, right = rot.quat_multiply(rot.quat_multiply(qa, qb), qc), rot.quat_multiply(qa, rot.quat_multiply(qb, qc))
    np.testing.assert_allclose(left, right, atol=1e-15)
    np.testing.assert_allclose(rot.quat_multiply(qa, rot.quat_conjugate(qa)), [1, 0, 0, 0], atol=1e-15)
    np.testing.assert_allclose(rot.matrix_from_quat(rot.quat_multiply(qa, qb)), Ra @ Rb, atol=4e-15)


def test_exponential_equals_scipy():
    v = rotvec_grid()
    expected = Rotation.from_rotvec(v.reshape(-1, 3)).as_matrix().reshape(*v.shape, 3)
    np.testing.assert_allclose(rot.exp_so3(v), expected, atol=2e-15)
    np.testing.assert_allclose(rot.matrix_from_quat(3.0 * rot.quat_from_rotvec(v)), expected, atol=2e-15)


@pytest.mark.parametrize("angle", ANGLES[:-2])
def test_logarithm_inverts_the_exponential(angle):
    v = rotvec_grid((angle,))
    np.testing.assert_allclose(rot.log_so3(rot.exp_so3(v)), v, rtol=0, atol=1e-14 + 1e-14 * angle)
    np.testing.assert_allclose(rot.rotvec_from_quat(-5.0 * rot.quat_from_rotvec(v)), v, rtol=1e-14, atol=1e-15)


def test_logarithm_at_pi_is_right_up_to_the_sign_of_the_axis():
    v = rotvec_grid((np.pi - 1e-9, np.pi))
    R = rot.exp_so3(v)
    back = rot.log_so3(R)
    np.testing.assert_allclose(rot.exp_so3(back), R, atol=3e-15)
    np.testing.assert_allclose(np.linalg.norm(back, axis=-1), np.linalg.norm(v, axis=-1), atol=1e-14)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-4, 0.3, 0.33, 1.5, 3.1, np.pi, 4.5, 6.0])
def test_left_jacobian_is_the_derivative_of_the_exponential(angle):
    v = rotvec_grid((angle,))[0, 3]
    R = rot.exp_so3(v)
    numeric = central_difference(lambda w: rot.log_so3(rot.exp_so3(w) @ R.T), v, 1e-3)
    np.testing.assert_allclose(rot.left_jacobian_so3(v), numeric, rtol=1e-9, atol=1e-10)
    product = rot.left_jacobian_so3(v) @ rot.left_jacobian_inverse_so3(v)
    np.testing.assert_allclose(product, np.eye(3), atol=1e-13)


def test_six_dimensions_round_trip_and_jacobian():
    rng = np.random.default_rng(1)
    R = rot.exp_so3(rng.normal(size=(20, 3)))
    np.testing.assert_allclose(rot.matrix_from_6d(rot.matrix_to_6d(R)), R, atol=1e-14)
    x = rng.normal(size=(20, 6)) * 2.0
    matrices, jacobians = rot.matrix_from_6d_with_jacobian(x)
    np.testing.assert_array_equal(matrices, rot.matrix_from_6d(x))
    np.testing.assert_allclose(matrices[..., 0], x[:, :3] / np.linalg.norm(x[:, :3], axis=1, keepdims=True), atol=1e-15)
    for one, M, J in zip(x, matrices, jacobians, strict=True):
        numeric = central_difference(lambda y, M=M: rot.log_so3(rot.matrix_from_6d(y) @ M.T), one, 1e-4)
        np.testing.assert_allclose(J, numeric, rtol=1e-7, atol=1e-9 * np.abs(J).max())


def test_degenerate_six_dimensions_stay_finite():
    for x in (np.zeros(6), np.array([1.0, 0, 0, 2.0, 0, 0])):
        assert all(np.isfinite(a).all() for a in rot.matrix_from_6d_with_jacobian(x))


def test_quaternion_tangent_is_the_derivative_by_a_left_rotation():
    rng = np.random.default_rng(2)
    q = rng.normal(size=4)
    q /= np.linalg.norm(q)
    G = rot.quat_left_tangent(q)
    numeric = central_difference(lambda w: rot.quat_multiply(rot.quat_from_rotvec(w), q), np.zeros(3), 1e-3)
    np.testing.assert_allclose(G, numeric, atol=1e-10)
    np.testing.assert_allclose(4.0 * G.T @ G, np.eye(3), atol=1e-15)
    R = rot.matrix_from_quat(q)
    turned = central_difference(lambda p: rot.log_so3(rot.matrix_from_quat(p) @ R.T), q)
    np.testing.assert_allclose(4.0 * G.T, turned, atol=1e-9)


def test_quaternion_of_every_half_turn_is_continuous_and_canonical():
    v = rotvec_grid((0.0, 1.0, np.pi - 1e-7))
    q = rot.quat_from_matrix(rot.exp_so3(v))
    assert (q[..., 0] >= 0).all()
    np.testing.assert_allclose(q, rot.quat_from_rotvec(v), atol=1e-14)


def test_skew_and_cross():
    a, b = np.random.default_rng(3).normal(size=(2, 5, 3))
    np.testing.assert_allclose(rot.cross(a, b), np.cross(a, b))
    np.testing.assert_allclose((rot.skew(a) @ b[..., None])[..., 0], np.cross(a, b))


VECTOR_FUNCTIONS = {
    rot.skew: 3, rot.exp_so3: 3, rot.left_jacobian_so3: 3, rot.left_jacobian_inverse_so3: 3, rot.quat_from_rotvec: 3,
    rot.rotvec_from_quat: 4, rot.matrix_from_quat: 4, rot.quat_conjugate: 4, rot.quat_left_tangent: 4,
    rot.matrix_from_6d: 6,
}  # fmt: skip


@pytest.mark.parametrize(("dtype", "atol"), [(np.float64, 1e-13), (np.float32, 2e-5)])
@pytest.mark.parametrize("function", [*VECTOR_FUNCTIONS, rot.log_so3, rot.quat_from_matrix, rot.matrix_to_6d])
def test_torch_equals_numpy_in_both_precisions(function, dtype, atol):
    if function in VECTOR_FUNCTIONS:
        x = np.random.default_rng(4).normal(size=(2, 7, VECTOR_FUNCTIONS[function]))
        x[0, 0] *= 1e-7 if x.shape[-1] == 3 else 1.0
    else:
        x = rot.exp_so3(rotvec_grid((0.0, 1e-6, 1.0, 3.1)))
    exact, single, tensor = function(x), function(x.astype(dtype)), function(torch.as_tensor(x.astype(dtype)))
    assert single.dtype == dtype and tensor.dtype == (torch.float64 if dtype is np.float64 else torch.float32)
    assert single.shape == exact.shape == tuple(tensor.shape)
    np.testing.assert_allclose(tensor.numpy(), exact, atol=atol)
    np.testing.assert_allclose(single, exact, atol=atol)


def test_torch_gradients_are_finite_at_the_identity():
    v = torch.zeros(2, 3, dtype=torch.float64, requires_grad=True)
    rot.log_so3(rot.exp_so3(v)).sum().backward()
    np.testing.assert_allclose(v.grad.numpy(), np.ones((2, 3)), atol=1e-12)
