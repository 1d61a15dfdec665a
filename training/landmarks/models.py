"""The networks side by side: what each costs on a batch of clouds, and where it places the landmarks."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Literal

import torch
from torch import nn

from solver_backend.labelling.outputs import JOINTS, MARKERS, PUBLISHED_JOINTS
from training.landmarks.cloud_stream import Clouds
from training.landmarks.drawing import SIZE, depth_maps, drawn, front_and_back
from training.landmarks.heatmaps import (
    HEAT_SHARE,
    SKIPPED,
    WELSCH_SHARE,
    divergence_from_gaussians,
    fused,
    gaussians_near,
    read_maps,
    relative_entropy,
    welsch,
)
from training.landmarks.point_loss import point_loss
from training.landmarks.point_net import PointNet, PointNetWidths
from training.landmarks.unet import UNet

Loss = Literal["welsch", "bmse"]
Divergence = Literal["kullback-leibler", "jensen-shannon"]
"""Of heatmaps; the paper's is the second, which has no gradient where a map is surely wrong."""
ALL_LANDMARKS = tuple(range(len(MARKERS) + len(JOINTS)))
PUBLISHED = (*range(len(MARKERS)), *(len(MARKERS) + JOINTS.index(name) for name in PUBLISHED_JOINTS))
"""Columns of the 53 markers and 18 joints."""
BMSE_SIGMA = 0.02
"""Noise of balanced MSE, in normalised units."""


class LandmarkModel(nn.Module, ABC):
    """A network that estimates where landmarks are from a cloud."""

    columns: tuple[int, ...] = ALL_LANDMARKS
    """Which of the 77 landmarks it estimates."""
    half_precision: bool = True
    """Whether a GPU may round products to bfloat16 in training: coordinates lose millimetres by it."""

    @abstractmethod
    def loss(self, clouds: Clouds) -> torch.Tensor:
        """Return the mean loss of the clouds, weighted by sample."""

    @abstractmethod
    def positions(self, clouds: Clouds) -> torch.Tensor:
        """Return the (B, columns, 3) positions in metres, Z up, in the clouds' frame."""


class Ours(LandmarkModel):
    """Attention over the points."""

    half_precision = False

    def __init__(self, widths: PointNetWidths = PointNetWidths(), asked_share: float = 1.0) -> None:
        super().__init__()
        self.net = PointNet(widths)
        self.asked_share = asked_share
        """Part of a batch that learns positions: a third of the time goes there, and labels are the harder half."""

    def loss(self, clouds: Clouds) -> torch.Tensor:
        """Labels, positions and covariances."""
        share = None if self.asked_share == 1.0 else max(1, round(self.asked_share * len(clouds.points)))
        return point_loss(self.net(clouds.points, clouds.seen, share), clouds)

    def positions(self, clouds: Clouds) -> torch.Tensor:
        """Return what landmarks point at, with their offsets."""
        return self.net(clouds.points, clouds.seen).positions


class Published(LandmarkModel):
    """Two views through one UNet, one after the other in the batch; heatmaps fused by the shared y (thesis 4.2.3)."""

    def __init__(
        self, width: int = 32, columns: tuple[int, ...] = PUBLISHED, loss: Loss = "welsch", size: int = SIZE,
        divergence: Divergence = "kullback-leibler",
    ) -> None:  # fmt: skip
        super().__init__()
        self.columns, self.kind, self.size, self.divergence = columns, loss, size, divergence
        self.unet = UNet(1, len(columns), width)
        self.register_buffer("which", torch.tensor(columns), persistent=False)

    def logits(self, maps: torch.Tensor, every: int = 1) -> torch.Tensor:
        """Return (B, 2, L, H, W), whose softmax the heatmaps are, of (B, 2, H, W) views; of every so many pixels."""
        return self.unet(maps.flatten(0, 1)[:, None], every).unflatten(0, (-1, 2))

    def loss(self, clouds: Clouds) -> torch.Tensor:
        """Divergence of the heatmaps and Welsch, or balanced MSE, of the positions (4.14, 4.15)."""
        points, seen, _, targets = drawn(clouds)
        truth = targets[:, self.get_buffer("which")]
        views = torch.stack((truth[..., 0], truth[..., 2]), 1), torch.stack((truth[..., 1],) * 2, 1)
        gaussians, pixels = gaussians_near(*views, self.size)
        reading = read_maps(self.logits(depth_maps(points, seen, self.size)), pixels)
        divergence = divergence_from_gaussians if self.divergence == "jensen-shannon" else relative_entropy
        apart, found = divergence(gaussians, reading.log_near).mean((1, 2)), fused(reading)
        weight = clouds.weight / clouds.weight.mean()
        if self.kind == "bmse":
            return HEAT_SHARE * apart.mean() + balanced_mse(found, truth, BMSE_SIGMA)
        return (weight * (HEAT_SHARE * apart + WELSCH_SHARE * welsch(truth, found).mean(1))).mean()

    def positions(self, clouds: Clouds) -> torch.Tensor:
        """Return the fused centres of mass."""
        points, seen, frame, _ = drawn(clouds)
        logits = self.logits(depth_maps(points, seen, self.size), SKIPPED)
        line = torch.linspace(-1.0, 1.0, self.size, device=logits.device)[::SKIPPED]
        return _z_up(frame.metres(fused(read_maps(logits, line=line))))


class DemocapLike(LandmarkModel):
    """Front and back depth of one view; a heatmap and a depth map of every landmark (after Chatzitofis et al. 2021)."""

    def __init__(
        self, width: int = 32, columns: tuple[int, ...] = PUBLISHED, loss: Loss = "welsch", size: int = SIZE
    ) -> None:
        super().__init__()
        self.columns, self.kind, self.size = columns, loss, size
        self.unet = UNet(2, 2 * len(columns), width)
        self.register_buffer("which", torch.tensor(columns), persistent=False)

    def _read(self, maps: torch.Tensor, pixels: torch.Tensor | None = None) -> tuple[torch.Tensor, torch.Tensor]:
        """Return (B, L, n) logarithms of heatmaps at pixels, and (B, L, 3) positions."""
        logits, depth = self.unet(maps).chunk(2, 1)
        reading = read_maps(logits, pixels)
        heat = (logits - reading.log_total[..., None, None]).exp()
        z = (heat * depth.tanh()).sum((-2, -1))
        return reading.log_near, torch.stack((reading.across, reading.down, 1.25 * z), -1)

    def loss(self, clouds: Clouds) -> torch.Tensor:
        """Divergence of the heatmaps and Welsch, or balanced MSE, of the positions; absolute distance in depth."""
        points, seen, _, targets = drawn(clouds)
        truth = targets[:, self.get_buffer("which")]
        gaussians, pixels = gaussians_near(truth[..., 0], truth[..., 1], self.size)
        log_near, found = self._read(front_and_back(points, seen, self.size), pixels)
        apart = relative_entropy(gaussians, log_near).mean(1)
        # Far from the truth Welsch's gradient fades, and no heatmap shows depth: absolute distance leads there.
        depth = (found[..., 2] - truth[..., 2]).abs().mean(1)
        if self.kind == "bmse":
            return (HEAT_SHARE * apart + depth).mean() + balanced_mse(found, truth, BMSE_SIGMA)
        weight = clouds.weight / clouds.weight.mean()
        return (weight * (HEAT_SHARE * apart + WELSCH_SHARE * welsch(truth, found).mean(1) + depth)).mean()

    def positions(self, clouds: Clouds) -> torch.Tensor:
        """Return centres of mass with the depth expected there."""
        points, seen, frame, _ = drawn(clouds)
        return _z_up(frame.metres(self._read(front_and_back(points, seen, self.size))[1]))


class FromCoordinates(LandmarkModel):
    """Dense layers on coordinates, the largest feature over the points (after Chen et al. 2021 and Qi et al. 2017)."""

    half_precision = False

    def __init__(self, width: int = 256, columns: tuple[int, ...] = PUBLISHED) -> None:
        super().__init__()
        self.columns = columns
        self.each = nn.Sequential(
            nn.Linear(3, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU(), nn.Linear(width, 4 * width)
        )
        self.all = nn.Sequential(
            nn.Linear(4 * width, 2 * width), nn.ReLU(), nn.Linear(2 * width, 2 * width), nn.ReLU(),
            nn.Linear(2 * width, 3 * len(columns)),
        )  # fmt: skip
        self.register_buffer("which", torch.tensor(columns), persistent=False)

    def _found(self, points: torch.Tensor, seen: torch.Tensor) -> torch.Tensor:
        features = torch.where(seen[..., None], self.each(points).float(), -1e4).amax(1)
        return self.all(features).float().unflatten(-1, (-1, 3))

    def loss(self, clouds: Clouds) -> torch.Tensor:
        """Mean distance of normalised positions."""
        points, seen, _, targets = drawn(clouds)
        error = self._found(points, seen) - targets[:, self.get_buffer("which")]
        weight = clouds.weight / clouds.weight.mean()
        return (weight * (error.square().sum(-1) + 1e-4).sqrt().mean(1)).mean()

    def positions(self, clouds: Clouds) -> torch.Tensor:
        """Return the regressed positions."""
        points, seen, frame, _ = drawn(clouds)
        return _z_up(frame.metres(self._found(points, seen)))


def balanced_mse(found: torch.Tensor, truth: torch.Tensor, sigma: float) -> torch.Tensor:
    """Return Ren et al.'s batch-based balanced MSE (2022, eq. 3.9) of (B, L, 3) positions, as a cross-entropy.

    Every landmark of every sample is to be nearer to its own truth than to the others' truths of the batch.
    """
    a, b = found.transpose(0, 1), truth.transpose(0, 1)
    logits = -torch.cdist(a, b).square() / (2.0 * sigma**2)
    own = torch.arange(len(found), device=found.device).expand(len(a), -1)
    return nn.functional.cross_entropy(logits.flatten(0, 1), own.flatten()) * 2.0 * sigma**2 * 100.0


def _z_up(points: torch.Tensor) -> torch.Tensor:
    return torch.stack((points[..., 0], -points[..., 2], points[..., 1]), -1)
