"""People and clouds as the thesis has them, eqs. 4.20 to 4.27, at the chances of its paper's appendix C."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from solver_backend.labelling.outputs import GHOST
from training.landmarks.corruption import SpoiledClouds

DOMINANT = 3
"""Coefficients of shape that 4.21 may draw anew: the first of them."""


def thesis_shapes(betas: torch.Tensor, shift_chance: float = 0.5, redraw_chance: float = 0.5) -> torch.Tensor:
    """Return (B, 10) shapes, all coefficients shifted by one number (4.20), up to three of the first drawn anew (4.21).

    The chances are the paper's: each augmentation is applied to half of the samples.
    """
    count, device = len(betas), betas.device
    shift = (2.0 * torch.rand(count, 1, device=device) - 1.0) * (torch.rand(count, 1, device=device) < shift_chance)
    number = torch.randint(DOMINANT + 1, (count, 1), device=device)
    anew = torch.rand(count, DOMINANT, device=device).argsort(1).argsort(1) < number
    anew = anew & (torch.rand(count, 1, device=device) < redraw_chance)
    shifted = betas + shift
    first = torch.where(anew, torch.randn(count, DOMINANT, device=device), shifted[:, :DOMINANT])
    return torch.cat((first, shifted[:, DOMINANT:]), 1)


@dataclass(frozen=True)
class ThesisCorruption:
    """Occlusion (4.22 to 4.24), ghosts of the remaining markers' Gaussian (4.25), bounded offsets (4.26, 4.27).

    The chances are the paper's. Neither the thesis nor the paper states how many markers are hidden, how many ghosts
    come or how far markers are moved: those numbers are ours.
    """

    device: str
    least_hidden: int = 0
    """m of 4.23."""
    most_hidden: int = 10
    """n' of 4.23."""
    most_ghosts: int = 4
    """n_ghost of 4.25 is uniform from 1 to this."""
    displacement_m: float = 0.02
    """M_noise of 4.26."""
    hidden_chance: float = 0.7
    ghost_chance: float = 0.7
    noise_chance: float = 0.8

    def __call__(self, places: torch.Tensor, worn: torch.Tensor) -> SpoiledClouds:
        """Return clouds of (B, P, 3) places of which ``worn`` (B, P) carry a marker; ghosts follow the 53 markers."""
        points, seen = places[:, :GHOST], worn[:, :GHOST]
        seen = seen & ~(self._chosen(seen, self.least_hidden, self.most_hidden) & self._at(self.hidden_chance, points))
        ghosts = self.ghosts(points, seen)
        number = torch.randint(1, self.most_ghosts + 1, (len(points), 1), device=self.device)
        there = (torch.arange(self.most_ghosts, device=self.device) < number) & self._at(self.ghost_chance, points)
        moved = self._chosen(torch.ones_like(seen), 1, GHOST) & self._at(self.noise_chance, points)
        offset = self.displacement_m * (2.0 * torch.rand(points.shape, device=self.device) - 1.0)
        labels = torch.where(seen, torch.arange(GHOST, device=self.device), -1)
        return SpoiledClouds(
            torch.cat((points + torch.where(moved[..., None], offset, 0.0), ghosts), 1),
            torch.cat((seen, there), 1),
            torch.cat((labels, torch.where(there, GHOST, -1)), 1),
        )

    def ghosts(self, points: torch.Tensor, seen: torch.Tensor) -> torch.Tensor:
        """Return (B, G, 3) draws from N(μ, Σ): per-axis median and sample covariance of the remaining markers (4.25).

        Sums of the centred points with weights of a standard normal have the sample's covariance.
        """
        share = seen[..., None].float()
        number = share.sum(1, keepdim=True).clamp(min=2.0)
        median = torch.where(seen[..., None], points, torch.nan).nanquantile(0.5, dim=1, keepdim=True)
        centred = (points - (points * share).sum(1, keepdim=True) / number) * share
        normal = torch.randn(len(points), self.most_ghosts, points.shape[1], device=self.device)
        return median + normal @ centred / (number - 1.0).sqrt()

    def _chosen(self, among: torch.Tensor, least: int, most: int) -> torch.Tensor:
        """Return (B, n) bool: k of ``among`` without replacement, k uniform from least to most."""
        rank = torch.where(among, torch.rand(among.shape, device=self.device), 2.0).argsort(1).argsort(1)
        return rank < torch.randint(least, most + 1, (len(among), 1), device=self.device)

    def _at(self, chance: float, like: torch.Tensor) -> torch.Tensor:
        """Return (B, 1) bool: which samples a mechanism is applied to."""
        return torch.rand(len(like), 1, device=self.device) < chance
