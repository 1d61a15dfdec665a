"""Interpolation along the manifold: even steps, ends approached, every pose projected."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from solver_backend.fitters.pose_ndf.complete import interpolate_poses
from solver_backend.geometry.rotations import exp_so3, quat_from_matrix
from solver_backend.priors.pose_ndf import ProjectionSettings, pose_distance
from tests.support.pose_ndf_weights import random_prior


def poses(count: int, seed: int) -> np.ndarray:
    return exp_so3(0.5 * np.random.default_rng(seed).standard_normal((count, 21, 3)))


def distance(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return pose_distance(quat_from_matrix(a), quat_from_matrix(b))


def test_without_projection_it_is_the_geodesic_shared_out_evenly(tmp_path: Path) -> None:
    start, end = poses(4, 0), poses(4, 1)
    found = interpolate_poses(random_prior(tmp_path), start, end, 5, ProjectionSettings(steps=0))
    way = np.concatenate([start[:, None], found, end[:, None]], axis=1)
    steps = distance(way[:, :-1], way[:, 1:])
    np.testing.assert_allclose(steps, np.broadcast_to(distance(start, end)[:, None] / 6, steps.shape), rtol=1e-9)


@pytest.mark.slow
def test_poses_between_lie_no_farther_from_the_manifold_than_the_geodesic(tmp_path: Path) -> None:
    prior, start, end, told = random_prior(tmp_path), poses(6, 2), poses(6, 3), []
    found = interpolate_poses(prior, start, end, 4, ProjectionSettings(), lambda *event: told.append(event))
    straight = interpolate_poses(prior, start, end, 4, ProjectionSettings(steps=0))
    assert found.shape == (6, 4, 21, 3, 3) and told[-1] == ("Interpolating", 4, 4)
    energies = [prior.energy(x.reshape(-1, 21, 3, 3)).mean() for x in (found, straight)]
    assert energies[0] < 0.98 * energies[1]
    target = prior.project(end)
    left = distance(found, target[:, None])
    assert (np.diff(left, axis=1) < 0).mean() > 0.9
    tensors = interpolate_poses(prior, torch.as_tensor(start), torch.as_tensor(end), 4, ProjectionSettings())
    np.testing.assert_allclose(tensors.numpy(), found, atol=1e-7)
