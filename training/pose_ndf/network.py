"""Network and losses of Pose-NDF in torch (Tiwari et al. 2022, sections 3.2 and 3.3)."""

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

from solver_backend.exchange.joint_sets import NUM_BODY_JOINTS
from solver_backend.geometry.rotations import upper_hemisphere
from solver_backend.metrics.positions import spearman
from solver_backend.priors.pose_ndf import JointSpread, PoseField, PoseNDF, SoftplusStack, in_metric, metric_length
from training.engine.loop import device_of
from training.pose_ndf.negatives import Labelled, Noise


@dataclass(frozen=True)
class PoseNdfSettings:
    """Settings of Pose-NDF's network, losses and data."""

    features: int = 8  # Features per joint. The paper uses 6.
    encoder_hidden: int = 16
    field_hidden: tuple[int, ...] = (384, 384, 384, 384)  # Hidden layers. The distance network has five layers.
    eikonal: float = 0.1  # Weight of the eikonal term.
    eikonal_share: float = 0.2  # Fraction of a batch used for the eikonal term, where it is valid.
    eikonal_from: float = 0.6
    """Smallest distance in radians for the eikonal loss. At smaller distances, the slope is below 1."""
    pool: int = 40_000
    """Number of poses far from the manifold. There are half as many recorded poses, twice as many near poses, and
    equally many poses visited by projections."""
    noise: Noise = "normal"  # Distribution of the rotations that make poses far from the manifold and near it.
    stages: tuple[float, ...] = (0.15, 0.5, 0.35)
    """Fraction of the steps per stage: poses far from and on the manifold, then also near it, then also projections."""
    validation: int = 1500  # Number of perturbed poses of unseen subjects used for validation.
    samples: int = 1000  # Number of samples to evaluate.


class PoseFieldNet(nn.Module):
    """Torch parameters of a ``PoseField``. The field's own code computes values and gradients."""

    def __init__(self, settings: PoseNdfSettings) -> None:
        super().__init__()
        features, hidden = settings.features, settings.encoder_hidden
        self.w0 = nn.Parameter(torch.randn(NUM_BODY_JOINTS, hidden, 4 + features) * (2.0 / (4 + features)) ** 0.5)
        self.b0 = nn.Parameter(0.1 * torch.randn(NUM_BODY_JOINTS, hidden))
        self.w1 = nn.Parameter(torch.randn(NUM_BODY_JOINTS, features, hidden) * (1.0 / hidden) ** 0.5)
        self.b1 = nn.Parameter(torch.zeros(NUM_BODY_JOINTS, features))
        widths = (NUM_BODY_JOINTS * features, *settings.field_hidden, 1)
        self.layers = nn.ModuleList(nn.Linear(a, b) for a, b in pairwise(widths))

    @property
    def field(self) -> PoseField:
        """The solver's pose field with these parameters. Gradients flow to the parameters."""
        layers = [cast(nn.Linear, layer) for layer in self.layers]
        stack = SoftplusStack(tuple(x.weight for x in layers), tuple(x.bias for x in layers), last_is_positive=True)
        return PoseField(self.w0, self.b0, self.w1, self.b1, stack)


class PoseNdfTask:
    """Losses on the poses of one training stage (Tiwari et al. 2022, eq. 4), and validation.

    The distances of recorded poses are not zero (see ``labelled``).
    """

    def __init__(
        self,
        model: PoseFieldNet,
        poses: Callable[[], Labelled],
        validation: Labelled,
        settings: PoseNdfSettings,
        batch: int,
    ) -> None:
        """Prepare one stage of the training.

        Args:
            model: network to train.
            poses: function that makes the poses of the stage. It is called once, for the first batch.
            validation: perturbed poses of unseen subjects.
            settings: losses and fractions.
            batch: number of poses per step.
        """
        self.model, self._make, self._validation = model, poses, validation
        self._settings, self._batch = settings, batch

    @cached_property
    def _poses(self) -> Labelled:
        return self._make()

    def draw(self, generator: torch.Generator) -> tuple[torch.Tensor, torch.Tensor]:
        """Draw a batch of the stage's poses, and their distances."""
        pool = self._poses
        chosen = torch.randint(len(pool.quats), (self._batch,), generator=generator)
        return upper_hemisphere(pool.quats[chosen]), pool.distance[chosen]

    def loss(self, batch: tuple[torch.Tensor, torch.Tensor], generator: torch.Generator) -> torch.Tensor:
        """Return the distance error plus the eikonal loss: ``mean |f - d| + λ mean (|∇f| - 1)²``.

        Gradient lengths are in the metric of the distance. Poses on the manifold do not contribute to the eikonal loss.

        Reference: Tiwari et al. 2022, eq. 4.
        """
        s, device = self._settings, device_of(self.model)
        quats, target = (tensor.to(device) for tensor in batch)
        steep, field = int(s.eikonal_share * self._batch), self.model.field
        distance, gradient = field.with_gradient(quats[:steep])
        off = (metric_length(in_metric(quats[:steep], gradient)) - 1.0) * (target[:steep] > s.eikonal_from)
        error = (torch.cat((distance, field(quats[steep:]))) - target).abs()
        return error.mean() + s.eikonal * off.square().mean()

    def evaluate(self, model: nn.Module) -> dict[str, float]:
        """Return the rank correlation and the mean error of distances for perturbed poses of unseen subjects."""
        with torch.no_grad():
            found = cast(PoseFieldNet, model).field(upper_hemisphere(self._validation.quats))
        truth = self._validation.distance
        return {
            "spearman": spearman(found.numpy(), truth.numpy()),
            "mean_error_rad": float((found - truth).abs().mean()),
        }


def as_prior(model: PoseFieldNet, spread: JointSpread) -> PoseNDF:
    """Return a prior with a copy of a network that may still be in training."""
    return PoseNDF(copy.deepcopy(model).requires_grad_(False).field, spread, {})


def field_arrays(model: PoseFieldNet) -> dict[str, np.ndarray]:
    """Return the arrays of a weight file: weights in half precision and biases in single precision."""
    arrays = {
        "encoder_w0": model.w0,
        "encoder_b0": model.b0,
        "encoder_w1": model.w1,
        "encoder_b1": model.b1,
    }
    for number, layer in enumerate(model.layers):
        linear = cast(nn.Linear, layer)
        arrays |= {f"field_w{number}": linear.weight, f"field_b{number}": linear.bias}
    return {
        name: value.detach().numpy().astype(np.float32 if "_b" in name else np.float16)
        for name, value in arrays.items()
    }
