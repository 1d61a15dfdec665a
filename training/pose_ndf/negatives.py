"""Training poses of Pose-NDF with their distances: recorded, rotated and blended poses, and poses of projections."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch

from solver_backend.exchange.joint_sets import NUM_BODY_JOINTS
from solver_backend.geometry.rotations import matrix_from_quat, quat_from_matrix, quat_from_rotvec, quat_multiply
from solver_backend.priors.pose_ndf import JOINT_WEIGHTS, JointSpread, PoseNDF, ProjectionSettings, pose_distance

NEIGHBOURS = 5  # Number of nearest poses in the mean distance (Tiwari et al. 2022, supplement).
_CANDIDATES = 64  # Number of poses to compare exactly after a coarse search. Chosen by hand.
_BLOCK = 512  # Poses processed together, which limits memory. Chosen by hand.


class NearestPoses:
    """Finds the nearest poses in a set, and their distances.

    Candidates are found by the chordal distance ``Σ w_k/2 sin²ψ_k = Σ w_k/8 (3 - tr R_kᵀ R'_k)``, one matrix product
    over all pairs. The geodesic distance ``Σ w_k/2 ψ_k²`` of the candidates decides.
    """

    def __init__(self, quats: torch.Tensor, people: torch.Tensor | None = None, device: str = "cpu") -> None:
        """Store unit quaternions (M, 21, 4) and, to exclude people, their person indices (M,).

        Arguments and results are on the CPU. The search runs on ``device``.
        """
        self.quats, self._people = quats.to(device, torch.float32), None if people is None else people.to(device)
        self._features = _features(self.quats)

    def mean_distance(self, quats: torch.Tensor, without: torch.Tensor | None = None) -> torch.Tensor:
        """Return the mean distance (N,) in radians from each pose (N, 21, 4) to its nearest poses.

        Args:
            quats: (N, 21, 4) unit quaternions.
            without: (N,) person to exclude for each pose, or None to exclude no one.
        """
        return self.distances(quats, without=without).mean(dim=1)

    def distances(
        self, quats: torch.Tensor, neighbours: int = NEIGHBOURS, *, without: torch.Tensor | None = None
    ) -> torch.Tensor:
        """Return ascending distances (N, neighbours) in radians from each pose (N, 21, 4) to its nearest poses."""
        blocks = quats.to(torch.float32).split(_BLOCK)
        left_out = without.split(_BLOCK) if without is not None else [None] * len(blocks)
        return torch.cat([self._block(*pair, neighbours)[0] for pair in zip(blocks, left_out, strict=True)])

    def nearest(self, quats: torch.Tensor) -> torch.Tensor:
        """Return the index (N,) of the nearest stored pose for each pose (N, 21, 4)."""
        return torch.cat([self._block(block, None, 1)[1][:, 0] for block in quats.to(torch.float32).split(_BLOCK)])

    def _block(
        self, quats: torch.Tensor, without: torch.Tensor | None, neighbours: int
    ) -> tuple[torch.Tensor, torch.Tensor]:
        count, quats = min(max(_CANDIDATES, 2 * neighbours), len(self.quats)), quats.to(self.quats.device)
        along = _features(quats) @ self._features.T
        if without is not None:
            assert self._people is not None
            along.masked_fill_(without.to(quats.device)[:, None] == self._people, -torch.inf)
        top = torch.topk(along, count, dim=1)
        distance = pose_distance(quats[:, None], self.quats[top.indices])
        distance, order = distance.masked_fill(torch.isinf(top.values), torch.inf).sort(dim=1)
        distance, index = distance[:, :neighbours], top.indices.gather(1, order)[:, :neighbours]
        return distance.cpu(), index.cpu()


def _features(quats: torch.Tensor) -> torch.Tensor:
    """Return rotation matrices (N, 189) times the root of their weights. Dot products are ``Σ w_k tr R_kᵀ R'_k``."""
    weights = torch.as_tensor(np.sqrt(JOINT_WEIGHTS), dtype=quats.dtype, device=quats.device)
    return (matrix_from_quat(quats) * weights[:, None, None]).flatten(1)


def unit_quats(rotations: torch.Tensor) -> torch.Tensor:
    """Convert poses (N, 21, 3, 3) to unit quaternions (N, 21, 4) in single precision."""
    return quat_from_matrix(rotations.to(torch.float64)).to(torch.float32)


Noise = Literal["normal", "von Mises"]
"""Distribution of the negatives' rotations: normal for each axis, or von Mises about a random axis."""
START_DEG = 60.0  # Standard deviation of the random poses from which projections start.
NOBODY = -1  # Person index of a pose that was not made from a recording.


@dataclass(frozen=True)
class PoseManifold:
    """The recorded poses that distances are measured from."""

    quats: torch.Tensor  # (M, 21, 4) unit quaternions.
    people: torch.Tensor  # (M,) person in each pose.
    nearest: NearestPoses

    @property
    def spread(self) -> JointSpread:
        """Distribution of each joint's rotations in the recorded poses."""
        return JointSpread.of(matrix_from_quat(self.quats.numpy().astype(np.float64)))

    @classmethod
    def of(cls, quats: torch.Tensor, people: torch.Tensor, device: str = "cpu") -> PoseManifold:
        """Store poses (M, 21, 4) and their people. Distances are computed on ``device``."""
        return cls(quats, people, NearestPoses(quats, people, device))

    def drawn(self, count: int, generator: torch.Generator) -> Poses:
        """Draw ``count`` random recorded poses."""
        chosen = torch.randint(len(self.quats), (count,), generator=generator)
        return Poses(self.quats[chosen], self.people[chosen])


@dataclass(frozen=True)
class Poses:
    """Poses, and the person in the recording that each pose was made from."""

    quats: torch.Tensor  # (N, 21, 4) unit quaternions.
    people: torch.Tensor  # (N,) person in each pose.

    def __len__(self) -> int:
        return len(self.quats)


@dataclass(frozen=True)
class Labelled:
    """Poses with their distances to the recorded poses."""

    quats: torch.Tensor  # (N, 21, 4) unit quaternions, single precision.
    distance: torch.Tensor  # (N,) mean distance in rad to the nearest recorded poses (``NearestPoses.mean_distance``).


def spread(count: int, degrees: tuple[float, float], generator: torch.Generator, *, even: bool = False) -> torch.Tensor:
    """Draw standard deviations (count,) in radians from a range in degrees, log-uniformly or uniformly (``even``)."""
    low, high = (math.radians(d) if even else math.log(math.radians(d)) for d in degrees)
    drawn = low + (high - low) * torch.rand(count, generator=generator)
    return drawn if even else torch.exp(drawn)


def rotated(poses: Poses, sigma: torch.Tensor, generator: torch.Generator, noise: Noise = "normal") -> Poses:
    """Rotate the joints of poses about random axes. In half of the poses, only some joints are rotated.

    Args:
        poses: N poses.
        sigma: (N,) standard deviation in radians about each axis.
        generator: generator of all draws.
        noise: distribution of the angles. The paper draws them from von Mises (Tiwari et al. 2022, 3.3).
    """
    count = len(sigma)
    some = torch.rand(count, 1, 1, generator=generator)
    share = torch.where(torch.rand(count, 1, 1, generator=generator) < 0.5, some, torch.ones(()))
    moved = torch.rand(count, NUM_BODY_JOINTS, 1, generator=generator) < share
    turn = torch.randn(count, NUM_BODY_JOINTS, 3, generator=generator)
    turn = (von_mises_turns(turn, sigma, generator) if noise == "von Mises" else turn * sigma[:, None, None]) * moved
    return Poses(quat_multiply(quat_from_rotvec(turn), poses.quats), poses.people)


def von_mises_turns(directions: torch.Tensor, sigma: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
    """Return rotation vectors (N, J, 3) along given directions, with von Mises distributed angles around zero.

    ``κ = 1 / (3 σ²)``: for small σ, the angle then equals a rotation by σ about each of three axes.

    Args:
        directions: (N, J, 3) directions, which must not be zero.
        sigma: (N,) standard deviations in radians.
        generator: generator of the angles.
    """
    seed = int(torch.randint(2**62, (), generator=generator))
    kappa = 1.0 / (3.0 * sigma.numpy().astype(np.float64) ** 2)
    angle = np.random.default_rng(seed).vonmises(0.0, kappa[:, None], directions.shape[:2])
    axis = directions / torch.linalg.vector_norm(directions, dim=-1, keepdim=True)
    return axis * torch.as_tensor(angle, dtype=directions.dtype)[..., None]


def blended(manifold: PoseManifold, count: int, generator: torch.Generator) -> Poses:
    """Blend random pairs of recorded poses, and normalise the quaternions."""
    a, b = (manifold.drawn(count, generator).quats for _ in range(2))
    b = torch.where((a * b).sum(-1, keepdim=True) < 0, -b, b)
    mixed = torch.lerp(a, b, torch.rand(count, 1, 1, generator=generator))
    return Poses(mixed / torch.linalg.vector_norm(mixed, dim=-1, keepdim=True), torch.full((count,), NOBODY))


def projected(prior: PoseNDF, manifold: PoseManifold, count: int, generator: torch.Generator) -> Poses:
    """Return about ``count`` poses that are projected onto the field in 4, 12 or 40 steps.

    A third of the projections start from random poses (one sigma is 60 degrees about every axis), and the others start
    from rotated recorded poses.
    """
    third = count // 3
    random = quat_from_rotvec(
        math.radians(START_DEG) / 3**0.5 * torch.randn(third, NUM_BODY_JOINTS, 3, generator=generator)
    )
    near = rotated(manifold.drawn(2 * third, generator), spread(2 * third, (5.0, 60.0), generator), generator)
    order = torch.randperm(3 * third, generator=generator)
    rotations = matrix_from_quat(torch.cat((random, near.quats))[order])
    parts = [
        prior.project(part, ProjectionSettings(steps=steps, reach=1.0))
        for part, steps in zip(rotations.split(third), (4, 12, 40), strict=True)
    ]
    people = torch.cat((torch.full((third,), NOBODY), near.people))[order]
    return Poses(quat_from_matrix(torch.cat(parts)), people)


def labelled(poses: Poses, manifold: PoseManifold) -> Labelled:
    """Return poses and their true distances to the recorded poses of all other people.

    For a new person, the distance to the recorded poses is similar to the distance between one recorded person and all
    others. If a person's own poses counted as neighbours, the field would learn that almost no pose is near. Measured
    medians are 0.40 rad for poses of unseen people and 0.07 rad for poses of recorded people.
    """
    quats = poses.quats.to(torch.float32)
    return Labelled(quats, manifold.nearest.mean_distance(quats, poses.people))


def joined(parts: list[Labelled]) -> Labelled:
    """Concatenate several sets of labelled poses."""
    return Labelled(torch.cat([p.quats for p in parts]), torch.cat([p.distance for p in parts]))
