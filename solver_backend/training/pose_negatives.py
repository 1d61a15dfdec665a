"""Poses off the manifold for Pose-NDF, from far to near: turned, blended, and met on the way of a projection."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch

from solver_backend.geometry.quaternions import matrix_from_quat, quat_from_matrix, quat_from_rotvec, quat_multiply
from solver_backend.priors.pose_ndf import PoseNDF, ProjectionSettings
from solver_backend.training.nearest_poses import NearestPoses

START_DEG = 60.0
"""Spread of the random poses whose projections are looked at, as in ``PoseNDF.sample``."""


@dataclass(frozen=True)
class Labelled:
    """Poses with their distance to the manifold."""

    quats: torch.Tensor
    """(N, 21, 4) unit, single precision."""
    distance: torch.Tensor
    """(N,) rad: the mean over the nearest recorded poses (``NearestPoses.mean_distance``)."""


def spread(count: int, degrees: tuple[float, float], generator: torch.Generator, *, even: bool = False) -> torch.Tensor:
    """Return (count,) standard deviations in rad from a range in degrees, even in their logarithm or themselves."""
    low, high = (math.radians(d) if even else math.log(math.radians(d)) for d in degrees)
    drawn = low + (high - low) * torch.rand(count, 1, 1, generator=generator)
    return (drawn if even else torch.exp(drawn))[:, 0, 0]


def turned_poses(poses: torch.Tensor, sigma: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
    """Return recorded poses whose joints are turned about random axes, half of them in some joints only.

    Args:
        poses: (M, 21, 4) to draw from.
        sigma: (N,) rad, standard deviation about each axis.
        generator: of every draw.
    """
    count = len(sigma)
    some = torch.rand(count, 1, 1, generator=generator)
    share = torch.where(torch.rand(count, 1, 1, generator=generator) < 0.5, some, torch.ones(()))
    moved = torch.rand(count, 21, 1, generator=generator) < share
    turn = torch.randn(count, 21, 3, generator=generator) * sigma[:, None, None] * moved
    return quat_multiply(quat_from_rotvec(turn), _drawn(poses, count, generator))


def blended_poses(poses: torch.Tensor, count: int, generator: torch.Generator) -> torch.Tensor:
    """Return points between pairs of recorded poses, normalised: (count, 21, 4)."""
    a, b = _drawn(poses, count, generator), _drawn(poses, count, generator)
    b = torch.where((a * b).sum(-1, keepdim=True) < 0, -b, b)
    mixed = torch.lerp(a, b, torch.rand(count, 1, 1, generator=generator))
    return mixed / torch.linalg.vector_norm(mixed, dim=-1, keepdim=True)


def projected_poses(prior: PoseNDF, poses: torch.Tensor, count: int, generator: torch.Generator) -> torch.Tensor:
    """Return (about) ``count`` poses met on the way down the field, after 4, 12 and 40 steps.

    A third starts at random poses (60 degrees about every axis, at one sigma), the rest at turned recorded ones.
    """
    third = count // 3
    random = quat_from_rotvec(math.radians(START_DEG) / 3**0.5 * torch.randn(third, 21, 3, generator=generator))
    starts = torch.cat((random, turned_poses(poses, spread(2 * third, (5.0, 60.0), generator), generator)))
    starts = starts[torch.randperm(len(starts), generator=generator)]
    rotations = matrix_from_quat(starts)
    parts = [
        prior.project(part, ProjectionSettings(steps=steps))
        for part, steps in zip(rotations.split(third), (4, 12, 40), strict=False)
    ]
    return quat_from_matrix(torch.cat(parts))


def labelled(quats: torch.Tensor, nearest: NearestPoses) -> Labelled:
    """Return poses with their true distances."""
    return Labelled(quats.to(torch.float32), nearest.mean_distance(quats))


def joined(parts: list[Labelled]) -> Labelled:
    """Return several sets as one."""
    return Labelled(torch.cat([p.quats for p in parts]), torch.cat([p.distance for p in parts]))


def _drawn(poses: torch.Tensor, count: int, generator: torch.Generator) -> torch.Tensor:
    return poses[torch.randint(len(poses), (count,), generator=generator)]
