"""What cameras make of markers, on whole batches in torch: thesis 4.22 to 4.27, and what real files do besides."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from solver_backend.labelling.outputs import GHOST
from training.landmarks.body_points import PLACES

OTHERS, FREE, PROP = 10, 4, 6
"""Points of other places, ghosts of the Gaussian and of reflections, and points of a rigid prop: at most."""


@dataclass(frozen=True)
class SpoiledClouds:
    """B clouds of N = 53 + 10 + 4 + 6 slots."""

    points: torch.Tensor
    """(B, N, 3)."""
    seen: torch.Tensor
    """(B, N) bool."""
    labels: torch.Tensor
    """(B, N), -1 where not seen."""


@dataclass(frozen=True)
class Corruption:
    """Occlusion (4.22-4.24), ghosts (4.25), noise (4.26, 4.27), points of other layouts, a prop in a hand."""

    device: str
    ghosts: bool = True
    noise: bool = True
    most_hidden: int = 10
    """n' of 4.23."""
    displacement_m: float = 0.02
    """M_noise of 4.26."""
    hidden_chance: float = 0.7
    ghost_chance: float = 0.6
    noise_chance: float = 0.8
    prop_chance: float = 0.08

    def __call__(self, places: torch.Tensor, worn: torch.Tensor) -> SpoiledClouds:
        """Return clouds of (B, P, 3) places of which ``worn`` (B, P) carry a marker."""
        count, device = len(places), self.device
        seen = worn[:, :GHOST] & ~self._hidden(worn[:, :GHOST])
        points = places[:, :GHOST]
        if self.noise:
            points = points + self._displaced(points)
        labels = torch.where(seen, torch.arange(GHOST, device=device), -1)
        if not self.ghosts:
            return SpoiledClouds(points, seen, labels)
        chosen = (worn[:, GHOST:] * (1.0 + torch.rand(count, len(PLACES) - GHOST, device=device))).topk(OTHERS, dim=1)
        others = places[:, GHOST:].gather(1, chosen.indices[..., None].expand(-1, -1, 3))
        free, there = self._free(points, seen)
        prop, held = self._prop(points)
        more = torch.cat((chosen.values > 0.5, there, held), 1)
        return SpoiledClouds(
            torch.cat((points, others, free, prop), 1),
            torch.cat((seen, more), 1),
            torch.cat((labels, torch.where(more, GHOST, -1)), 1),
        )

    def _hidden(self, worn: torch.Tensor) -> torch.Tensor:
        """Return (B, 53) bool: k of the markers worn, k uniform from 0 to n', and never all of them."""
        count = len(worn)
        rank = torch.where(worn, torch.rand(worn.shape, device=self.device), 2.0).argsort(1).argsort(1)
        k = torch.randint(self.most_hidden + 1, (count, 1), device=self.device)
        k = torch.minimum(k, worn.sum(1, keepdim=True) - 1)
        return (rank < k) & (torch.rand(count, 1, device=self.device) < self.hidden_chance)

    def _displaced(self, points: torch.Tensor) -> torch.Tensor:
        """Return offsets in a cube for a part of the points, and millimetres for all of them."""
        shape = points.shape[:2]
        share = torch.rand(shape[0], 1, device=self.device)
        moved = (torch.rand(shape, device=self.device) < 0.6 * share)[..., None]
        moved = moved & (torch.rand(shape[0], 1, 1, device=self.device) < self.noise_chance)
        cube = self.displacement_m * (2.0 * torch.rand(points.shape, device=self.device) - 1.0)
        return torch.where(moved, cube, 0.0) + 0.001 * torch.randn(points.shape, device=self.device)

    def _free(self, points: torch.Tensor, seen: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return (B, 4, 3) ghosts and which are there: of the visible points' Gaussian, or beside a marker."""
        count, device = len(points), self.device
        gaussian = self.gaussian(points, seen)
        beside = points[:, torch.randint(points.shape[1], (FREE,), device=device)]
        reach = 0.03 + 0.2 * torch.rand(count, FREE, 1, device=device)
        beside = beside + reach * torch.nn.functional.normalize(torch.randn(count, FREE, 3, device=device), dim=-1)
        ghosts = torch.where(torch.rand(count, FREE, 1, device=device) < 0.35, beside, gaussian)
        there = torch.arange(FREE, device=device) < torch.randint(1, FREE + 1, (count, 1), device=device)
        return ghosts, there & (torch.rand(count, 1, device=device) < self.ghost_chance)

    def gaussian(self, points: torch.Tensor, seen: torch.Tensor) -> torch.Tensor:
        """Return (B, 4, 3) draws with the mean of the visible points and 1.2 times their deviations (4.25).

        Sums of the centred points with weights of a standard normal have the sample's covariance.
        """
        share = seen[..., None].float()
        number = share.sum(1, keepdim=True).clamp(min=2.0)
        mean = (points * share).sum(1, keepdim=True) / number
        draw = torch.randn(len(points), FREE, points.shape[1], device=self.device) @ ((points - mean) * share)
        return mean + 1.2 * draw / (number - 1.0).sqrt()

    def _prop(self, points: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return (B, 6, 3) points of a stick or a box near one of the markers, and which are there."""
        count, device = len(points), self.device
        near = points.gather(1, torch.randint(points.shape[1], (count, 1, 1), device=device).expand(-1, -1, 3))
        longest = torch.arange(3, device=device) == 0
        size = (0.08 + 0.42 * longest) * (0.5 + torch.rand(count, 1, 1, device=device))
        shape = size * (2.0 * torch.rand(count, PROP, 3, device=device) - 1.0)
        frame = torch.nn.functional.normalize(torch.randn(count, 3, 3, device=device), dim=-1)
        there = torch.arange(PROP, device=device) < torch.randint(2, PROP + 1, (count, 1), device=device)
        return near + shape @ frame, there & (torch.rand(count, 1, device=device) < self.prop_chance)
