"""Keyframe layout, interpolation and the derivative of frames by keys."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from solver_backend.fitters.model.codes import CODES
from solver_backend.fitters.model.keyframe_curve import KeyframeLayout, bundle_frames
from tests.support.random_keys import random_keys
from tests.support.toy_prior import ToyPrior

FRAMES, WINDOW = 27, 9


def tangent_between(R: np.ndarray, R0: np.ndarray) -> np.ndarray:
    flat = Rotation.from_matrix((R @ np.swapaxes(R0, -1, -2)).reshape(-1, 3, 3)).as_rotvec()
    return flat.reshape(R.shape[:-2] + (3,))


@pytest.mark.parametrize(("num_frames", "window"), [(4, 20), (27, 9), (100, 20), (101, 7), (21, 20)])
def test_layout_covers_every_frame_once(num_frames, window):
    layout = KeyframeLayout.even(num_frames, window)
    index, time = layout.positions(layout.frames)
    np.testing.assert_array_equal(layout.frames, np.arange(num_frames))
    assert time.min() >= 0 and time.max() <= 1
    np.testing.assert_allclose(layout.bounds[index] + time * np.diff(layout.bounds)[index], layout.frames, atol=1e-9)
    rows = layout.rows()
    np.testing.assert_array_equal(np.sort(rows.frames[rows.weight > 0]), np.arange(num_frames))
    for w in range(layout.num_windows):
        inside = rows.weight[w] > 0
        np.testing.assert_array_equal(index[rows.frames[w, inside]], w)
        np.testing.assert_allclose(rows.time[w, inside], time[rows.frames[w, inside]])


@pytest.mark.parametrize("stride", [2, 3, 7])
def test_rows_with_a_stride_stand_for_the_frames_left_out(stride):
    rows = KeyframeLayout.even(101, 20).rows(stride)
    assert 101 - 5 * stride <= rows.weight.sum() <= 101 + 5 * stride
    assert (np.diff(rows.frames, axis=1)[rows.weight[:, 1:] > 0] == stride).all()


def test_frames_pass_through_their_keys():
    layout = KeyframeLayout.even(FRAMES, WINDOW)
    keys = random_keys(layout.num_keys)
    prior = ToyPrior()
    for k, when in enumerate((0.0, 0.5, 1.0)):
        window = np.arange(layout.num_windows)
        frames = bundle_frames(prior, keys, window, np.full(len(window), when), residuals=False)
        chosen = keys.select(2 * window + k)
        np.testing.assert_allclose(frames.poses.transl, chosen.transl, atol=1e-12)
        np.testing.assert_allclose(frames.poses.local, prior.decode(chosen.z), atol=1e-9)


@pytest.mark.parametrize("residuals", [False, True])
def test_derivative_by_keys_equals_central_differences(residuals):
    layout = KeyframeLayout.even(FRAMES, WINDOW)
    keys, prior = random_keys(layout.num_keys), ToyPrior()
    dof = 99 if residuals else 36
    window, time = layout.positions(layout.frames)
    base = bundle_frames(prior, keys, window, time, residuals=residuals)
    step = 1e-5
    rng = np.random.default_rng(4)
    for _ in range(6):
        direction = rng.normal(size=(layout.num_keys, dof))

        def tangents(sign, direction=direction):
            moved = keys.retract(sign * step * direction)
            poses = bundle_frames(prior, moved, window, time, residuals=residuals).poses
            root = tangent_between(poses.root, base.poses.root)
            local = tangent_between(poses.local, base.poses.local).reshape(FRAMES, -1)
            return np.concatenate([root, local, poses.transl - base.poses.transl], axis=1)

        numeric = (tangents(1) - tangents(-1)) / (2 * step)
        stacked = np.stack([direction[2 * window + k] for k in range(3)], axis=1).reshape(FRAMES, -1)
        analytic = np.einsum("fij,fj->fi", base.by_keys, stacked)
        np.testing.assert_allclose(analytic, numeric, atol=1e-6 * np.abs(numeric).max())


def test_latent_tangents_are_an_orthonormal_basis_of_the_constraint():
    z = CODES.nearest(np.random.default_rng(0).normal(size=(50, 32)))
    basis = CODES.tangent_basis(z)
    np.testing.assert_allclose(np.swapaxes(basis, 1, 2) @ basis, np.tile(np.eye(30), (50, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(basis.sum(axis=1), 0, atol=1e-12)
    np.testing.assert_allclose(np.einsum("fi,fij->fj", z, basis), 0, atol=1e-12)
