"""Pose-NDF: gradients through the tree, q against -q, NumPy against torch, projection, files."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import torch

from solver_backend.body.joint_limits import excess_deg
from solver_backend.exchange.errors import PoseInvalid, WeightsInvalid
from solver_backend.exchange.joint_sets import SMPL_PARENTS
from solver_backend.geometry.rotations import exp_so3, log_so3, quat_from_matrix
from solver_backend.priors.pose_ndf import (
    JOINT_WEIGHTS,
    LEVELS,
    PoseNDF,
    ProjectionSettings,
    in_metric,
    load_pose_ndf,
    pose_distance,
)
from solver_backend.priors.weights import ASSETS, PriorWeights, write_weights
from tests.support.pose_ndf_weights import SIZE, arrays, random_prior


@pytest.fixture
def prior(tmp_path: Path) -> PoseNDF:
    return random_prior(tmp_path)


def poses(count: int, seed: int = 1) -> np.ndarray:
    return exp_so3(0.6 * np.random.default_rng(seed).standard_normal((count, 21, 3)))


def test_levels_hold_every_joint_below_its_parent() -> None:
    joints = [joint for level in LEVELS for joint in level.joints]
    assert sorted(joints) == list(range(21))
    for above, level in pairwise(LEVELS):
        for row, joint in zip(level.parents, level.joints, strict=True):
            assert above.joints[int(np.flatnonzero(row)[0])] == SMPL_PARENTS[joint + 1] - 1 and row.sum() == 1


def test_a_parents_turn_changes_its_childrens_features_and_no_others(prior: PoseNDF) -> None:
    R = poses(1)
    turned = R.copy()
    turned[:, 15] = exp_so3(np.array([0.3, 0.2, -0.4])) @ R[:, 15]
    field, order = prior._field, [joint for level in LEVELS for joint in level.joints]
    before, after = (
        np.concatenate(field._encode(prior.encode(x).reshape(1, 21, 4).transpose(1, 0, 2))[0]) for x in (R, turned)
    )
    changed = {order[i] for i in np.flatnonzero(np.abs(after - before).max(axis=(1, 2)) > 1e-12)}
    assert changed == {15, 17, 19}  # left shoulder, elbow, wrist


def test_gradient_against_central_differences(prior: PoseNDF) -> None:
    z, step = prior.encode(poses(4)), 1e-6
    _, gradient = prior.distance_with_gradient(z)
    for i in range(84):
        d = step * np.eye(84)[i]
        numeric = (prior.distance_with_gradient(z + d)[0] - prior.distance_with_gradient(z - d)[0]) / (2 * step)
        np.testing.assert_allclose(gradient[:, i], numeric, atol=1e-7)


def test_tangents_against_central_differences(prior: PoseNDF) -> None:
    R, step = poses(3), 1e-6
    _, tangents = prior.distance_with_tangents(R)
    for i in range(63):
        turn = exp_so3(step * np.eye(63)[i].reshape(21, 3))
        numeric = (prior.energy(turn @ R) - prior.energy(np.swapaxes(turn, -1, -2) @ R)) / (2 * step)
        np.testing.assert_allclose(tangents.reshape(3, 63)[:, i], numeric, atol=1e-7)


def test_gradient_in_the_metric_is_what_a_step_along_it_gains(prior: PoseNDF) -> None:
    quats = prior.encode(poses(4)).reshape(4, 21, 4)
    gradient = prior.distance_with_gradient(quats.reshape(4, 84))[1].reshape(4, 21, 4)
    steepest = in_metric(quats, gradient)
    square = (0.5 * JOINT_WEIGHTS[:, None] * steepest**2).sum((1, 2))
    np.testing.assert_allclose(square, (gradient * steepest).sum((1, 2)), rtol=1e-10)
    assert np.abs((steepest * quats).sum(-1)).max() < 1e-12


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


def test_projection_stops_at_the_level_and_within_reach(prior: PoseNDF) -> None:
    start = poses(30)
    before = prior.energy(start)
    level = float(np.median(before))
    settled = prior.project(start, ProjectionSettings(level=level))
    near = before <= level
    np.testing.assert_allclose(settled[near], start[near], atol=1e-12)
    assert (prior.energy(settled)[~near] < before[~near]).all()
    assert prior.energy(settled).min() >= min(before.min(), 0.99 * level) - 1e-9
    way = pose_distance(*(quat_from_matrix(x) for x in (prior.project(start, ProjectionSettings(reach=0.3)), start)))
    assert (way <= 0.3 * before + 1e-6).all() and way.max() > 0.1 * before.min()


@pytest.mark.misshapen
def test_bad_input_is_named(prior: PoseNDF, tmp_path: Path) -> None:
    with pytest.raises(PoseInvalid, match=r"shape \(N, 84\)"):
        prior.distance_with_gradient(np.zeros((2, 63)))
    with pytest.raises(PoseInvalid, match=r"not of unit length.*Divide"):
        prior.distance_with_gradient(1.1 * prior.encode(poses(2)))
    for call in (prior.project, prior.energy, prior.distance_with_tangents):
        with pytest.raises(PoseInvalid, match="NaN"):
            call(np.full((1, 21, 3, 3), np.nan))
        with pytest.raises(PoseInvalid, match=r"shape \(N, 21, 3, 3\)"):
            call(poses(2)[:, :20])
        with pytest.raises(PoseInvalid, match=r"not rotations.*pose 1"):
            call(poses(2) * np.array([1.0, 1.1])[:, None, None, None])


@pytest.mark.parametrize(
    ("metadata", "changed", "message"),
    [
        ({"field_size": SIZE}, {"encoder_w0": np.zeros((21, 6, 4))}, r"encoder_w0.*\(21, 6, 4\), not \(21, 5, 7\)"),
        ({"field_size": SIZE}, {"field_b1": np.full(16, np.nan)}, "field_b1.*not numbers"),
        ({}, {}, "do not state the network's size"),
        ({"field_size": SIZE, "body_joints": ["pelvis"]}, {}, "a body with other joints"),
        ({"field_size": SIZE, "version": 99}, {}, "version 99, but 1 is needed"),
    ],
)
def test_weights_that_do_not_fit_are_named(tmp_path: Path, metadata, changed, message) -> None:
    path = tmp_path / "pose_ndf.npz"
    write_weights(path, PriorWeights("pose_ndf", arrays() | changed, metadata))
    with pytest.raises(WeightsInvalid, match=message):
        load_pose_ndf(path)


def test_weights_of_another_prior_are_named(tmp_path: Path) -> None:
    path = tmp_path / "pose_ndf.npz"
    write_weights(path, PriorWeights("rvposer", arrays(), {"field_size": SIZE}))
    with pytest.raises(WeightsInvalid, match="'rvposer', not 'pose_ndf'"):
        load_pose_ndf(path)


def test_shipped_weights_pull_noise_to_poses_a_body_can_take() -> None:
    prior = load_pose_ndf()
    assert (ASSETS / "pose_ndf.npz").stat().st_size < 4_000_000
    rest = np.tile(np.eye(3), (1, 21, 1, 1))
    assert prior.energy(rest)[0] < 0.5 < prior.energy(poses(20)).min()
    sampled = prior.sample(40, seed=5)
    assert prior.energy(sampled).max() < 0.5
    noise = poses(20)
    assert (prior.energy(prior.project(noise)) < 0.5 * prior.energy(noise)).all()
    assert (excess_deg(sampled) > 0).any(axis=1).mean() <= 0.05
