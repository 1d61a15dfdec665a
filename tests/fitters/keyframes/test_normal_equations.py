"""The matrix of the refinement, which mixes the keys' pose tangents in single precision, against the exact one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solver_backend.fitters.keyframes import normal_equations
from solver_backend.fitters.keyframes.normal_equations import KeyframeNormalEquations, data_equations, matrices_by_keys
from solver_backend.fitters.model.keyframe_curve import KeyframeCurve
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout, WindowRows, lagrange
from solver_backend.fitters.model.subject import Keyframes, d_pose_d_key, frame_equations
from solver_backend.geometry.interpolation import spherical_normalisation
from solver_backend.priors.base import PosePrior
from tests.support.finer_keys import resampled
from tests.support.layouts import POSE, WHOLE
from tests.support.random_keys import random_keys
from tests.support.stick_scene import FRAMES, ROTATIONS, StickScene
from tests.support.toy_prior import ToyPrior

LAYOUT = KeyframeLayout.even(33, 8)
WINDOWS, COUNT = np.arange(LAYOUT.num_windows), LAYOUT.num_windows
DOF = WHOLE.dof


class ExactToyPrior(ToyPrior):
    """Whose derivative is taken in double precision, whatever the codes come in."""

    def decode_with_jacobian(self, z):
        return super().decode_with_jacobian(spherical_normalisation(np.asarray(z, dtype=np.float64)))


def keys_near(spread: float) -> Keyframes:
    """Return keys that differ from one another by about ``spread``."""
    keys, steps = random_keys(LAYOUT.num_keys, seed=3), np.random.default_rng(5).normal(size=(LAYOUT.num_keys, DOF))
    return keys.select(np.zeros(LAYOUT.num_keys, dtype=int)).retract(spread * steps, WHOLE)


def hessians(rows: WindowRows) -> np.ndarray:
    """Return (W n, 69, 69) positive definite matrices of the frames."""
    half = np.random.default_rng(6).normal(size=(rows.frames.size, POSE.dof, POSE.dof))
    return half @ half.swapaxes(-1, -2)


def mixed(prior: PosePrior, keys: Keyframes, rows: WindowRows, hessian: np.ndarray) -> np.ndarray:
    """Return (W, 297, 297): the matrices with the pose tangents of the keys alone."""
    return matrices_by_keys(rows, hessian, d_pose_d_key(WHOLE, prior, keys.z, keys.residual))


def exact(prior: PosePrior, keys: Keyframes, rows: WindowRows, hessian: np.ndarray) -> np.ndarray:
    """Return (W, 297, 297): ``Σ_f w_f B_fᵀ H_f B_f`` with the curve's own Jacobian."""
    windows, dof = np.arange(len(rows.time)), POSE.dof
    B = KeyframeCurve.through(keys.of_windows(windows), rows.time, residuals=True).jacobian(prior, WHOLE)
    B = B.reshape(*rows.time.shape, dof, -1)
    weighted = rows.weight[..., None, None] * hessian.reshape(*rows.time.shape, dof, dof) @ B
    return (B.swapaxes(-1, -2) @ weighted).sum(axis=1)


def difference(spread: float) -> float:
    """Return how far the mixed matrix is from the exact one, as a share of it, both in double precision."""
    prior, keys, rows = ExactToyPrior(), keys_near(spread), LAYOUT.rows()
    H = hessians(rows)
    found, expected = mixed(prior, keys, rows, H), exact(prior, keys, rows, H)
    assert found.dtype == np.float64
    return float(np.linalg.norm(found - expected) / np.linalg.norm(expected))


def test_the_mixed_matrix_of_equal_keys_is_the_exact_one():
    assert difference(0.0) < 1e-12


def test_the_mixed_matrix_approaches_the_exact_one_with_the_distance_of_the_keys():
    near, nearer = difference(1e-2), difference(1e-3)
    assert near < 0.01
    assert nearer < 0.11 * near


def test_the_mixed_matrix_is_its_formula():
    """``P_aᵀ (Σ_f w_a w_b H_f) P_b``, key by key and frame by frame, for keys of any distance."""
    keys, rows, prior = random_keys(LAYOUT.num_keys), LAYOUT.rows(), ExactToyPrior()
    H = hessians(rows)
    found = mixed(prior, keys, rows, H)
    at_keys = KeyframeCurve.through(keys.of_windows(WINDOWS), np.tile([0.0, 0.5, 1.0], (COUNT, 1)), residuals=True)
    B, shares = at_keys.jacobian(prior, WHOLE).reshape(COUNT, 3, POSE.dof, 3, DOF), lagrange(rows.time)
    of_frames = H.reshape(*rows.time.shape, POSE.dof, -1)
    for a in range(3):
        for b in range(3):
            weight = rows.weight * shares[..., a] * shares[..., b]
            M = np.einsum("wn,wnij->wij", weight, of_frames)
            expected = B[:, a, :, a].swapaxes(-1, -2) @ M @ B[:, b, :, b]
            block = found[:, a * DOF : (a + 1) * DOF, b * DOF : (b + 1) * DOF]
            np.testing.assert_allclose(block, expected, atol=1e-6 * np.abs(expected).max())


def dense(equations: KeyframeNormalEquations) -> np.ndarray:
    """Return the matrix of all keys but the dummy."""
    count, size, met = len(equations.g), equations.g.shape[1], equations.upper.shape[-1]
    full = np.zeros((count * size, count * size))
    for w in range(count):
        own = slice(w * size, (w + 1) * size)
        full[own, own] = equations.diagonal[w]
        if w + 1 < count:
            after = slice((w + 1) * size, (w + 1) * size + met)
            full[own, after] = equations.upper[w]
            full[after, own] = equations.upper[w].T
    free = full.shape[0] - equations.dof
    return full[:free, :free]


@pytest.mark.slow
def test_the_step_of_the_mixed_matrix_descends_and_agrees_with_the_exact_step():
    scene = StickScene()
    layout = KeyframeLayout.even(FRAMES, 5)
    keys, rows = resampled(scene.start, scene.layout, layout), layout.rows()
    keys = replace(keys, residual=0.02 * np.random.default_rng(2).normal(size=keys.residual.shape))
    data = data_equations(scene.data(residuals=True), keys, rows, 3.0, rows.frames.shape[1])
    poses = KeyframeCurve.through(keys.of_windows(np.arange(layout.num_windows)), rows.time, residuals=True).poses(
        scene.prior
    )
    frames = frame_equations(scene.subject, poses, scene.objective.select(rows.frames.reshape(-1)), 3.0)
    mixed, whole = dense(data.normal_equations()), normal_equations.FLOOR * np.eye(data.gradient.size)
    for w, window in enumerate(exact(scene.prior, keys, rows, frames.hessian)):
        own = slice(2 * w * DOF, (2 * w + 3) * DOF)
        whole[own, own] += window
    # What the data cannot tell is damped alike in both, so that the steps may be compared.
    damping, g = 1e3 * np.eye(len(whole)), data.gradient.reshape(-1)
    found, best = (-np.linalg.solve(matrix + damping, g) for matrix in (mixed, whole))
    assert found @ g < 0 and best @ g < 0
    assert found @ best > 0.98 * np.linalg.norm(found) * np.linalg.norm(best)
    moved = keys.retract(0.5 * found.reshape(-1, DOF), WHOLE)
    assert data_equations(scene.data(residuals=True), moved, rows, 3.0).cost.sum() < data.cost.sum()


def test_fixing_keys_changes_nothing_but_the_returned_equations():
    scene, fixed = StickScene(), np.isin(np.arange(7), (0, 3))
    equations = scene.model(ROTATIONS).equations(scene.layout.rows(), scene.start, 3.0)[1]()
    before = [part.copy() for part in (equations.diagonal, equations.upper, equations.g)]
    held = equations.with_fixed(fixed)
    for part, old in zip((equations.diagonal, equations.upper, equations.g), before, strict=True):
        np.testing.assert_array_equal(part, old)
    step = held.block_tridiagonal().solve(np.array([1e-3])).reshape(-1, DOF)[:7]
    assert np.abs(step[fixed]).max() < 1e-9 < np.abs(step[~fixed]).max()
    assert equations.with_fixed(np.zeros(7, dtype=bool)) is equations
