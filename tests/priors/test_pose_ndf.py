"""Pose-NDF: gradients through the tree, q against -q, NumPy against torch, projection, files."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import torch

from solver_backend.errors import PoseInvalid, WeightsInvalid
from solver_backend.geometry.rotations import exp_so3, log_so3
from solver_backend.priors.pose_ndf import ENCODER_HIDDEN, FEATURES, PoseNDF, load_pose_ndf
from solver_backend.priors.weights import PriorWeights, write_weights
from solver_backend.types.joint_sets import SMPL_PARENTS

HIDDEN = (24, 16)


def arrays(seed: int = 0) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    parts = {
        f"joint{k}": (4 if SMPL_PARENTS[k + 1] == 0 else 4 + FEATURES, ENCODER_HIDDEN, FEATURES) for k in range(21)
    }
    parts["field"] = (21 * FEATURES, *HIDDEN, 1)
    out = {}
    for part, widths in parts.items():
        for i, (a, b) in enumerate(pairwise(widths)):
            out[f"{part}_w{i}"] = rng.standard_normal((b, a)) / np.sqrt(a)
            out[f"{part}_b{i}"] = 0.1 * rng.standard_normal(b)
    return out


@pytest.fixture
def prior(tmp_path: Path) -> PoseNDF:
    path = tmp_path / "pose_ndf.npz"
    write_weights(path, PriorWeights("pose_ndf", arrays(), {"field_hidden": HIDDEN}))
    return load_pose_ndf(path)


def poses(count: int, seed: int = 1) -> np.ndarray:
    return exp_so3(0.6 * np.random.default_rng(seed).standard_normal((count, 21, 3)))


def test_gradient_against_central_differences(prior: PoseNDF) -> None:
    z, step = prior.encode(poses(4)), 1e-6
    _, gradient = prior.distance_with_gradient(z)
    for i in range(84):
        d = step * np.eye(84)[i]
        numeric = (prior.distance_with_gradient(z + d)[0] - prior.distance_with_gradient(z - d)[0]) / (2 * step)
        np.testing.assert_allclose(gradient[:, i], numeric, atol=1e-7)


def test_opposite_quaternions_are_one_pose(prior: PoseNDF) -> None:
    z = prior.encode(poses(5))
    sign = np.repeat(np.random.default_rng(2).choice([-1.0, 1.0], (5, 21)), 4, axis=1)
    here, there = prior.distance_with_gradient(z), prior.distance_with_gradient(sign * z)
    np.testing.assert_array_equal(here[0], there[0])
    np.testing.assert_array_equal(here[1], sign * there[1])


def test_decoder_undoes_encoder_and_has_its_jacobian(prior: PoseNDF) -> None:
    R = poses(3)
    z = prior.encode(R)
    decoded, J = prior.decode_with_jacobian(z)
    np.testing.assert_allclose(decoded, R, atol=1e-12)
    for i in range(84):
        d = 1e-5 * np.eye(84)[i]
        turn = log_so3(prior.decode(z + d) @ np.swapaxes(prior.decode(z - d), -1, -2)) / 2e-5
        np.testing.assert_allclose(J[..., i], turn, atol=1e-8)


def test_numpy_against_torch(prior: PoseNDF) -> None:
    R = poses(6)
    np.testing.assert_allclose(prior.energy(torch.as_tensor(R)).numpy(), prior.energy(R), rtol=1e-10)
    np.testing.assert_allclose(prior.project(torch.as_tensor(R)).numpy(), prior.project(R), atol=1e-8)


def test_projection_never_raises_the_distance(prior: PoseNDF) -> None:
    R = poses(30)
    projected = prior.project(R)
    before, after = prior.energy(R), prior.energy(projected)
    assert (before > 0).all() and (after <= before).all() and np.median(after / before) < 0.95
    np.testing.assert_allclose(
        np.swapaxes(projected, -1, -2) @ projected, np.broadcast_to(np.eye(3), R.shape), atol=1e-9
    )
    np.testing.assert_array_equal(prior.sample(3, seed=0), prior.sample(3, seed=0))


def test_bad_input_is_named(prior: PoseNDF, tmp_path: Path) -> None:
    with pytest.raises(PoseInvalid, match=r"shape \(N, 84\)"):
        prior.distance_with_gradient(np.zeros((2, 63)))
    with pytest.raises(PoseInvalid, match="NaN"):
        prior.project(np.full((1, 21, 3, 3), np.nan))
    path = tmp_path / "pose_ndf.npz"
    write_weights(path, PriorWeights("pose_ndf", arrays() | {"joint3_w0": np.zeros((6, 4))}, {"field_hidden": HIDDEN}))
    with pytest.raises(WeightsInvalid, match=r"joint3_w0.*\(6, 4\), not \(6, 10\)"):
        load_pose_ndf(path)
