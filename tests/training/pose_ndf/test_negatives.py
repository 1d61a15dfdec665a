"""Poses off the manifold: how far they are, from whom, and what a projection meets."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from solver_backend.exchange.errors import JobInvalid
from solver_backend.priors.pose_ndf import pose_distance
from tests.support.swaying_people import SMALL, random_quats, swaying
from training.pose_ndf.negatives import (
    NOBODY,
    PoseManifold,
    Poses,
    blended,
    labelled,
    projected,
    rotated,
    spread,
    von_mises_turns,
)
from training.pose_ndf.network import (
    PoseFieldNet,
    as_prior,
)
from training.pose_ndf.train import manifold_of


def test_turned_poses_lie_as_far_as_they_are_turned() -> None:
    manifold, generator = PoseManifold.of(random_quats(50, 0), torch.arange(50)), torch.Generator().manual_seed(0)
    near, far = (
        rotated(manifold.drawn(300, generator), spread(300, degrees, generator), generator)
        for degrees in ((1.0, 2.0), (30.0, 60.0))
    )
    nearest = [manifold.nearest.distances(poses.quats, 1)[:, 0].median() for poses in (near, far)]
    assert 0.03 < nearest[0] < 0.08 and 1.0 < nearest[1] < 2.2
    mixed = blended(manifold, 100, generator)
    np.testing.assert_allclose(torch.linalg.vector_norm(mixed.quats, dim=-1).numpy(), 1.0, rtol=1e-6)
    assert (mixed.people == NOBODY).all()


def test_von_mises_turns_are_as_long_as_normal_ones_while_they_are_small_and_never_a_full_turn() -> None:
    generator = torch.Generator().manual_seed(0)
    directions = torch.randn(4000, 21, 3, generator=generator)
    for sigma, expected in ((0.05, 0.05 * 3**0.5), (20.0, math.pi / 3**0.5)):
        turns = von_mises_turns(directions, torch.full((4000,), sigma), generator)
        length = torch.linalg.vector_norm(turns, dim=-1)
        assert float(length.square().mean().sqrt()) == pytest.approx(expected, rel=0.02) and length.max() <= math.pi
        assert torch.linalg.vector_norm(torch.linalg.cross(turns, directions), dim=-1).max() < 1e-4
    poses = Poses(random_quats(300, 0), torch.arange(300))
    one, again, other = (
        rotated(poses, torch.full((300,), 0.5), torch.Generator().manual_seed(seed), "von Mises").quats
        for seed in (1, 1, 2)
    )
    assert torch.equal(one, again) and not torch.equal(one, other)


def test_distances_are_to_the_poses_of_other_people() -> None:
    quats, people = random_quats(90, 0), torch.arange(90) % 3
    manifold = PoseManifold.of(quats, people)
    asked = Poses(random_quats(12, 1), torch.tensor([0, 1, 2, NOBODY] * 3))
    found = labelled(asked, manifold).distance
    for pose, who, distance in zip(asked.quats, asked.people, found, strict=True):
        every = pose_distance(pose.double(), quats[people != who].double()).sort().values[:5].mean()
        assert float(distance) == pytest.approx(float(every), rel=3e-3)
    own = Poses(quats, people)
    assert labelled(own, manifold).distance.min() > 0.5 > manifold.nearest.distances(quats, 1).max()
    alone = swaying(0)
    with pytest.raises(JobInvalid, match="several people"):
        manifold_of(replace(alone, subjects=("01", "01")))


def test_projected_poses_lie_nearer_than_they_started(tmp_path: Path) -> None:
    torch.manual_seed(0)
    manifold = PoseManifold.of(random_quats(30, 5), torch.arange(30))
    prior = as_prior(PoseFieldNet(SMALL), manifold.spread)
    met = projected(prior, manifold, 31, torch.Generator().manual_seed(0))
    assert met.quats.shape == (30, 21, 4) and int((met.people == NOBODY).sum()) == 10
    np.testing.assert_allclose(torch.linalg.vector_norm(met.quats, dim=-1).numpy(), 1.0, rtol=1e-5)
