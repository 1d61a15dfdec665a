"""Which poses a batch is made of: recorded ones, weighed by how rare they are, and rare ones drawn by an operator."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch

from solver_backend.priors.balance import exponential_relevance, sigmoid_relevance
from solver_backend.training.landmarks.cloud_stream import Clouds, CloudStream
from solver_backend.training.landmarks.poses import PoseTable

RELEVANCE = {"e(R)": "reconstruction", "σ(R)": "reconstruction", "e(D)": "mahalanobis", "σ(D)": "mahalanobis"}
"""What each relevance is of."""
SYNTHETIC_SHARE = 0.25
"""Part of a batch that an operator draws."""
EXPONENTIAL_SCALE = 1.5
"""φ of the exponential kernel over the median error, so that not every pose is clamped; the sigmoid's is the median."""


@dataclass(frozen=True)
class Balance:
    """How training is balanced; not at all by default."""

    relevance: str = ""
    """One of ``RELEVANCE``, or none."""
    sampler: str = ""
    """One of ``SAMPLERS``, or none."""
    oversampled: bool = False
    """Recorded poses are drawn by their relevance, not weighed."""


def relevance_of(table: PoseTable, kind: str) -> np.ndarray:
    """Return the (N,) relevance of the training poses."""
    error = table.arrays[RELEVANCE[kind]].astype(np.float64)
    median = float(np.median(error))
    if kind.startswith("e"):
        return exponential_relevance(error, EXPONENTIAL_SCALE * median)
    return sigmoid_relevance(error, median)


def drawer(stream: CloudStream, table: PoseTable, batch: int, balance: Balance = Balance()) -> Callable[[], Clouds]:
    """Return what draws a batch of clouds, on the stream's device and by torch's own generator."""
    device = stream.device
    recorded = torch.as_tensor(table.poses("training"), device=device)
    weight = torch.ones(len(recorded), device=device)
    if balance.relevance:
        weight = torch.as_tensor(relevance_of(table, balance.relevance), dtype=torch.float32, device=device)
    edges = torch.cumsum(weight.double(), 0)
    edges = (edges / edges[-1]).float()
    drawn = round(SYNTHETIC_SHARE * batch) if balance.sampler else 0
    rare = torch.as_tensor(table.poses(balance.sampler), device=device) if balance.sampler else recorded[:1]
    # What is blended of anchors counts as much as the rarest of what was recorded.
    rare_weight = torch.quantile(weight[:: max(1, len(weight) // 10000)], 0.99).expand(drawn).clone()

    def draw() -> Clouds:
        share = torch.rand(batch - drawn, device=device)
        if balance.oversampled:
            rows = torch.searchsorted(edges, share).clamp(max=len(recorded) - 1)
            weights = torch.ones_like(share)
        else:
            rows = (share * len(recorded)).long().clamp(max=len(recorded) - 1)
            weights = weight[rows]
        poses = recorded[rows]
        if drawn:
            poses = torch.cat((poses, rare[torch.randint(len(rare), (drawn,), device=device)]))
            weights = torch.cat((weights, torch.ones_like(rare_weight) if balance.oversampled else rare_weight))
        return stream.draw(poses, weights)

    return draw
