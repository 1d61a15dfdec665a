"""What reconstructions cost: distances of points, and rotations that do not agree (thesis eqs. 6.3, 6.4)."""

from __future__ import annotations

import torch

from training.data.points import rotation_points


def pose_loss(truth: torch.Tensor, decoded: torch.Tensor, weight: torch.Tensor, orthogonality: float) -> torch.Tensor:
    """Return ``2 mean w (mean_p |p - p̂|² + λ mean_j (1 - cos angle_j))`` over (N, 21, 3, 3) poses, distances in dm.

    L_rec: points stand for the mesh's vertices: joints, and tips on the axes of every joint's frame. L_orth: the thesis
    prints ``cos = (Tr - 1) / 2`` itself, which falls as rotations part; what is minimised is one less it. The factor 2
    makes the mean over keys and frames between, which come as one batch, the sum of both.

    Args:
        truth: (N, 21, 3, 3).
        decoded: (N, 21, 3, 3).
        weight: (N,) w.
        orthogonality: λ.

    Reference: thesis eqs. 6.1, 6.3, 6.4 (eqs. 4.18 and 4.19 of the variational autoencoders).
    """
    distance = (10.0 * (rotation_points(truth) - rotation_points(decoded))).square().sum(-1).mean(-1)
    trace = (truth * decoded).sum((-2, -1))
    misaligned = (1.0 - 0.5 * (trace - 1.0)).mean(-1)
    return 2.0 * (weight * (distance + orthogonality * misaligned)).mean()
