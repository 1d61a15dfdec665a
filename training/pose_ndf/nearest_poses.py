"""The poses of a set that lie nearest to others in the geodesic distance, by matrix products."""

from __future__ import annotations

import numpy as np
import torch

from solver_backend.geometry.quaternions import matrix_from_quat, quat_from_matrix
from solver_backend.priors.pose_ndf.pose_distance import JOINT_WEIGHTS, pose_distance

NEIGHBOURS = 5
"""Nearest poses whose distances are averaged (Tiwari et al. 2022, supplement)."""
_CANDIDATES = 64
"""Poses that are compared exactly, after a coarse search; chosen by hand."""
_BLOCK = 512
"""Poses that are searched for at a time, which bounds memory; chosen by hand."""


class NearestPoses:
    """A set of poses that answers how far others are from it.

    Candidates come from the chordal distance ``Σ w_k/2 sin²ψ_k = Σ w_k/8 (3 - tr R_kᵀ R'_k)``, one matrix product over
    all pairs; the geodesic distance ``Σ w_k/2 ψ_k²`` of the candidates decides.
    """

    def __init__(self, quats: torch.Tensor, people: torch.Tensor | None = None, device: str = "cpu") -> None:
        """Take (M, 21, 4) unit quaternions and, if some are to be left out, whose (M,) they are.

        What is asked and answered is on the CPU; the search runs on ``device``.
        """
        self.quats, self._people = quats.to(device, torch.float32), None if people is None else people.to(device)
        self._features = _features(self.quats)

    def mean_distance(self, quats: torch.Tensor, without: torch.Tensor | None = None) -> torch.Tensor:
        """Return the mean distance (N,) of (N, 21, 4) poses to their nearest ones, rad.

        Args:
            quats: the poses.
            without: (N,) people whose poses do not count for each; all count if None.
        """
        return self.distances(quats, without=without).mean(dim=1)

    def distances(
        self, quats: torch.Tensor, neighbours: int = NEIGHBOURS, *, without: torch.Tensor | None = None
    ) -> torch.Tensor:
        """Return the distances (N, neighbours) of (N, 21, 4) poses to their nearest ones, ascending, rad."""
        blocks = quats.to(torch.float32).split(_BLOCK)
        left_out = without.split(_BLOCK) if without is not None else [None] * len(blocks)
        return torch.cat([self._block(*pair, neighbours)[0] for pair in zip(blocks, left_out, strict=True)])

    def nearest(self, quats: torch.Tensor) -> torch.Tensor:
        """Return the index (N,) of the nearest pose."""
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
    """Return (N, 189): rotation matrices times the root of their weights, whose products are ``Σ w_k tr R_kᵀ R'_k``."""
    weights = torch.as_tensor(np.sqrt(JOINT_WEIGHTS), dtype=quats.dtype, device=quats.device)
    return (matrix_from_quat(quats) * weights[:, None, None]).flatten(1)


def unit_quats(rotations: torch.Tensor) -> torch.Tensor:
    """Return (N, 21, 4) unit quaternions of (N, 21, 3, 3) poses in single precision."""
    return quat_from_matrix(rotations.to(torch.float64)).to(torch.float32)
