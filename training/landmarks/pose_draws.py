"""Which poses a batch is made of: recorded ones, weighed by how rare they are, and rare ones drawn by an operator."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch

from solver_backend.priors.balance import exponential_relevance, sigmoid_relevance
from training.landmarks.cloud_stream import Clouds, CloudStream
from training.landmarks.poses import PoseTable

RELEVANCE = {"e(R)": "reconstruction", "σ(R)": "reconstruction", "e(D)": "mahalanobis", "σ(D)": "mahalanobis"}
"""What each relevance is of."""
FADES = (0.45, 0.75)
"""Shares of a training between which a balance that fades gives way to the recorded poses as they are."""
EXPONENTIAL_SCALE = 1.5
"""φ of the exponential kernel over the median error, so that not every pose is clamped; the sigmoid's is the median."""

Draw = Callable[[torch.Tensor], Clouds]
"""Draws a batch, given the share of the training that is done."""


@dataclass(frozen=True)
class Balance:
    """How training is balanced; not at all by default."""

    relevance: str = ""
    """One of ``RELEVANCE``, or none."""
    sampler: str = ""
    """One of ``SAMPLERS``, or none."""
    blended: float = 0.25
    """Poses that the operator adds to a batch, for each that was recorded: oversampling takes none of those away."""
    fades: bool = False
    """In the last part ordinary poses count as they occur: rare ones are learned by then, and they finish the rest."""


def relevance_of(table: PoseTable, kind: str) -> np.ndarray:
    """Return the (N,) relevance of the training poses."""
    error = table.arrays[RELEVANCE[kind]].astype(np.float64)
    median = float(np.median(error))
    if kind.startswith("e"):
        return exponential_relevance(error, EXPONENTIAL_SCALE * median)
    return sigmoid_relevance(error, median)


def drawer(stream: CloudStream, table: PoseTable, batch: int, balance: Balance = Balance()) -> Draw:
    """Return what draws a batch of clouds for a share of the training, on the stream's device, by torch's generator.

    Args:
        stream: makes clouds of poses.
        table: recorded poses, and those that operators blended.
        batch: recorded poses of a batch; what a sampler blends comes on top.
        balance: how they are weighed, and what is added.
    """
    device = stream.device
    recorded = torch.as_tensor(table.poses("training"), device=device)
    weight = torch.ones(len(recorded), device=device)
    if balance.relevance:
        weight = torch.as_tensor(relevance_of(table, balance.relevance), dtype=torch.float32, device=device)
    drawn = round(balance.blended * batch) if balance.sampler else 0
    rare = torch.as_tensor(table.poses(balance.sampler), device=device) if balance.sampler else recorded[:1]
    # What is blended of anchors counts as much as the rarest of what was recorded.
    rare_weight = torch.quantile(weight[:: max(1, len(weight) // 10000)], 0.99).expand(drawn).clone()

    added = torch.arange(batch + drawn, device=device) >= batch

    def draw(done: torch.Tensor) -> Clouds:
        rows = (torch.rand(batch, device=device) * len(recorded)).long().clamp(max=len(recorded) - 1)
        blended = rare[torch.randint(len(rare), (drawn,), device=device)]
        poses, weights = torch.cat((recorded[rows], blended)), torch.cat((weight[rows], rare_weight))
        if balance.fades:
            left = ((FADES[1] - done) / (FADES[1] - FADES[0])).clamp(0.0, 1.0)
            weights = (1.0 + (weights - 1.0) * left) * torch.where(added, left, 1.0)
            if device == "cpu" and not left:  # a GPU's step is one graph: what counts for nothing stays there
                poses, weights = poses[:batch], weights[:batch]
        return stream.draw(poses, weights)

    return draw
