"""What our network's readings cost: labels by point and by marker, positions, and their covariances."""

from __future__ import annotations

import torch
from torch.nn.functional import cross_entropy

from solver_backend.labelling.outputs import GHOST
from training.landmarks.cloud_stream import Clouds
from training.landmarks.point_net import Reading

MARKER_SHARE, POSITION_SHARE, SPREAD_SHARE = 0.5, 4.0, 0.05
FREEDOM = 4.0
"""Degrees of freedom of Student's t; chosen by hand."""
_SHARP_M = 0.01
"""Distance below which the loss is a square, metres; chosen by hand."""


def point_loss(reading: Reading, clouds: Clouds) -> torch.Tensor:
    """Return the mean over samples of the labels' cross-entropies, the positions' robust distance and their likelihood.

    A point's label is a softmax over markers and ghost, a marker's point one over points and "missing". Covariances
    learn from positions that they do not move, so that no landmark is given up as uncertain.
    """
    weight = clouds.weight / clouds.weight.mean()
    seen = clouds.labels >= 0
    row = cross_entropy(reading.scores.transpose(1, 2), clouds.labels.clamp(min=0), reduction="none")
    row = (row * seen).sum(1) / seen.sum(1).clamp(min=1)
    by_marker = torch.where(seen[..., None], reading.scores[..., :GHOST], -30000.0)
    lacking = reading.missing.expand(len(by_marker), 1, -1)
    mine = clouds.labels[..., None] == torch.arange(GHOST, device=seen.device)
    which = torch.where(mine.any(1), mine.float().argmax(1), mine.shape[1])
    column = cross_entropy(torch.cat((by_marker, lacking), 1), which, reduction="none").mean(1)
    error = reading.positions - clouds.targets[: len(reading.positions)]
    distance = (error.square().sum(-1) + _SHARP_M**2).sqrt() - _SHARP_M
    likelihood = spread_loss(reading.spread, 10.0 * error.detach())
    positions = POSITION_SHARE * distance.mean(1) + SPREAD_SHARE * likelihood.mean(1)
    position_weight = weight[: len(positions)]
    return (weight * (row + MARKER_SHARE * column)).mean() + (position_weight * positions).mean()


def spread_loss(spread: torch.Tensor, error: torch.Tensor) -> torch.Tensor:
    """Return ``(ν + 3)/2 log(1 + |Lᵀ e|²/ν) - log det L`` of (..., 6) factors and (..., 3) errors in dm.

    Student's likelihood, ν = 4: one wrong landmark must not blow up the covariances of all.
    """
    log_diagonal, lower = spread[..., :3].clamp(-4.0, 5.0), spread[..., 3:]
    diagonal = log_diagonal.exp()
    x, y, z = error.unbind(-1)
    white = (
        (diagonal[..., 0] * x + lower[..., 0] * y + lower[..., 1] * z).square()
        + (diagonal[..., 1] * y + lower[..., 2] * z).square()
        + (diagonal[..., 2] * z).square()
    )
    return 0.5 * (FREEDOM + 3.0) * torch.log1p(white / FREEDOM) - log_diagonal.sum(-1)
