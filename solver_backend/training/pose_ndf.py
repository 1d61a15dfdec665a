"""Pose-NDF's network and losses in torch (Tiwari et al. 2022, 3.2, 3.3)."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import cast

import numpy as np
import torch
from torch import nn

from solver_backend.priors.pose_distance import JOINT_WEIGHTS
from solver_backend.priors.pose_field import PoseField
from solver_backend.priors.pose_ndf import PoseNDF, in_metric
from solver_backend.priors.softplus_stack import SoftplusStack
from solver_backend.training.pose_negatives import Labelled

NUM_JOINTS = 21


@dataclass(frozen=True)
class PoseNdfSettings:
    """Network, losses and data of Pose-NDF."""

    features: int = 8
    """Length of a joint's feature; the paper takes 6."""
    encoder_hidden: int = 16
    field_hidden: tuple[int, ...] = (384, 384, 384, 384)
    """Hidden layers of the five-layer distance network."""
    eikonal: float = 0.1
    """Weight of the eikonal term."""
    eikonal_share: float = 0.5
    """Share of the negatives on which it is taken."""
    on_manifold: float = 0.3
    """Share of a batch that are recorded poses, of distance 0."""
    pool: int = 40_000
    """Negatives drawn anew for each stage."""
    stages: tuple[float, ...] = (1.0,)
    """Share of the steps: far from the manifold, nearer, what projections meet, and more of that. One stage is the
    default: after three (3/7, 2/7, 2/7 of 7,000 steps) 7 % of the samples lay outside the limits of joints and 93 % of
    the projections lowered the true distance, with no better ranking."""
    validation: int = 1500
    """Perturbed poses of unseen subjects that are measured on."""
    samples: int = 1000
    """Samples that are looked at."""


class PoseFieldNet(nn.Module):
    """The parameters of ``PoseField``; stored so that the field's own code computes value and gradient."""

    def __init__(self, settings: PoseNdfSettings) -> None:
        super().__init__()
        features, hidden = settings.features, settings.encoder_hidden
        self.w0 = nn.Parameter(torch.randn(NUM_JOINTS, hidden, 4 + features) * (2.0 / (4 + features)) ** 0.5)
        self.b0 = nn.Parameter(0.1 * torch.randn(NUM_JOINTS, hidden))
        self.w1 = nn.Parameter(torch.randn(NUM_JOINTS, features, hidden) * (1.0 / hidden) ** 0.5)
        self.b1 = nn.Parameter(torch.zeros(NUM_JOINTS, features))
        widths = (NUM_JOINTS * features, *settings.field_hidden, 1)
        self.layers = nn.ModuleList(nn.Linear(a, b) for a, b in pairwise(widths))

    @property
    def field(self) -> PoseField:
        """The network as the shipped code knows it; gradients flow to the parameters."""
        layers = [cast(nn.Linear, layer) for layer in self.layers]
        stack = SoftplusStack(tuple(x.weight for x in layers), tuple(x.bias for x in layers), last_is_positive=True)
        return PoseField(self.w0, self.b0, self.w1, self.b1, stack)


class PoseNdfTask:
    """Losses (4) on one stage's poses, and validation."""

    def __init__(
        self,
        model: PoseFieldNet,
        manifold: torch.Tensor,
        negatives: Callable[[], Labelled],
        validation: Labelled,
        settings: PoseNdfSettings,
        batch: int,
    ) -> None:
        """Prepare a stage.

        Args:
            model: what is trained on.
            manifold: (M, 21, 4) recorded poses.
            negatives: makes the stage's poses off the manifold; asked once, when the first batch is drawn.
            validation: perturbed poses of unseen subjects.
            settings: losses and shares.
            batch: poses a step.
        """
        self.model, self._manifold, self._make, self._validation = model, manifold, negatives, validation
        self._settings, self._batch = settings, batch

    @cached_property
    def _negatives(self) -> Labelled:
        return self._make()

    def loss(self, step: int, generator: torch.Generator) -> torch.Tensor:
        """Return ``mean |f - d| + λ mean (|∇f| - 1)²``, the gradient in the metric of the distance."""
        s, pool = self._settings, self._negatives
        count = int(s.on_manifold * self._batch)
        on = self._manifold[torch.randint(len(self._manifold), (count,), generator=generator)]
        chosen = torch.randint(len(pool.quats), (self._batch - count,), generator=generator)
        steep = int(s.eikonal_share * len(chosen))
        quats = upper(torch.cat((pool.quats[chosen], on)))
        target = torch.cat((pool.distance[chosen], torch.zeros(count)))
        field = self.model.field
        distance, gradient = field.with_gradient(quats[:steep])
        length = metric_length(quats[:steep], gradient)
        rest = field(quats[steep:])
        error = (torch.cat((distance, rest)) - target).abs()
        return error.mean() + s.eikonal * (length - 1.0).square().mean()

    def evaluate(self, model: nn.Module) -> dict[str, float]:
        """Return how the field ranks and measures the perturbed poses of unseen subjects."""
        with torch.no_grad():
            found = cast(PoseFieldNet, model).field(upper(self._validation.quats))
        truth = self._validation.distance
        return {
            "spearman": spearman(found.numpy(), truth.numpy()),
            "mean_error_rad": float((found - truth).abs().mean()),
        }


def as_prior(model: PoseFieldNet) -> PoseNDF:
    """Return the prior of a network that is still being trained."""
    return PoseNDF(copy.deepcopy(model).requires_grad_(False).field, {})


def spearman(a: np.ndarray, b: np.ndarray) -> float:
    """Return the correlation of the ranks of two lists of numbers without ties (Spearman 1904)."""
    return float(np.corrcoef(np.argsort(np.argsort(a)), np.argsort(np.argsort(b)))[0, 1])


def metric_length(quats: torch.Tensor, gradient: torch.Tensor) -> torch.Tensor:
    """Return the length (N,) of a gradient by quaternions in the metric of ``pose_distance``."""
    steepest = in_metric(quats, gradient)
    weights = torch.as_tensor(0.5 * JOINT_WEIGHTS, dtype=quats.dtype)
    return torch.sqrt((weights[:, None] * steepest.square()).sum(dim=(1, 2)) + 1e-12)


def upper(quats: torch.Tensor) -> torch.Tensor:
    """Return the same rotations as quaternions with ``w >= 0``."""
    return torch.where(quats[..., :1] < 0, -quats, quats)


def field_arrays(model: PoseFieldNet, dtype: type = np.float16) -> dict[str, np.ndarray]:
    """Return the arrays of a weight file: weights in ``dtype``, biases in single precision."""
    arrays = {
        "encoder_w0": model.w0, "encoder_b0": model.b0, "encoder_w1": model.w1, "encoder_b1": model.b1,
    }  # fmt: skip
    for number, layer in enumerate(model.layers):
        linear = cast(nn.Linear, layer)
        arrays |= {f"field_w{number}": linear.weight, f"field_b{number}": linear.bias}
    return {
        name: value.detach().numpy().astype(np.float32 if "_b" in name else dtype) for name, value in arrays.items()
    }
