"""The nearest poses of a set against comparing all, and quaternions of poses."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from solver_backend.geometry.rotations import matrix_from_quat
from solver_backend.priors.pose_ndf import pose_distance
from tests.support.swaying_people import random_quats
from training.pose_ndf.negatives import NearestPoses, unit_quats


@pytest.mark.parametrize("scale", [0.1, 0.8])
def test_nearest_poses_against_comparing_all(scale: float) -> None:
    poses, queries = random_quats(700, 0), random_quats(40, 1, scale)
    every = pose_distance(queries[:, None].double(), poses[None].double()).sort(dim=1)
    nearest = NearestPoses(poses)
    np.testing.assert_allclose(nearest.distances(queries).numpy(), every.values[:, :5].numpy(), rtol=3e-3)
    np.testing.assert_allclose(nearest.mean_distance(-queries).numpy(), every.values[:, :5].mean(1).numpy(), rtol=3e-3)
    assert (nearest.nearest(poses[:50]) == torch.arange(50)).all()


def test_unit_quats_are_the_rotations() -> None:
    quats = random_quats(5, 7)
    assert float(pose_distance(unit_quats(matrix_from_quat(quats)), quats).max()) < 2e-3
