"""Heatmaps of landmarks: drawn, read by their centre of mass, fused by the shared axis, and compared (4.14, 4.15)."""

from __future__ import annotations

import math

import torch

SIGMA_PX = 2.0
"""Spread of a drawn heatmap."""
REACH_SIGMAS = 4.5
"""Beyond so many spreads a Gaussian holds nothing."""
WELSCH_NU = 0.05
HEAT_SHARE, WELSCH_SHARE = 1.0, 1.0


def gaussian_heatmaps(u: torch.Tensor, v: torch.Tensor, size: int) -> torch.Tensor:
    """Return (..., size, size) maps that sum to 1, about unquantised (...) coordinates in -1..1; rows along v."""
    return _profile(v, size)[..., :, None] * _profile(u, size)[..., None, :]


def _profile(where: torch.Tensor, size: int) -> torch.Tensor:
    """Return the (..., size) profiles along one axis, which sum to 1."""
    pixels = torch.linspace(-1.0, 1.0, size, device=where.device)
    sigma = 2.0 * SIGMA_PX / (size - 1)
    return torch.softmax(-0.5 * ((pixels - where.clamp(-1.0, 1.0)[..., None]) / sigma).square(), -1)


def expectations(heatmaps: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the centres of mass, along columns and rows, of (..., S, S) maps that sum to 1."""
    pixels = torch.linspace(-1.0, 1.0, heatmaps.shape[-1], device=heatmaps.device)
    v, u = torch.meshgrid(pixels, pixels, indexing="ij")
    centre = heatmaps.flatten(-2) @ torch.stack((u.flatten(), v.flatten()), -1)
    return centre[..., 0], centre[..., 1]


def fused(heatmaps: torch.Tensor) -> torch.Tensor:
    """Return (B, L, 3) normalised positions of (B, 2, L, H, W) maps of the xy and yz views; y is the mean of both."""
    across, down = expectations(heatmaps)
    return torch.stack((across[:, 0], 0.5 * (down[:, 0] + down[:, 1]), across[:, 1]), -1)


def log_normalised(logits: torch.Tensor) -> torch.Tensor:
    """Return logarithms of (..., H, W) maps that sum to 1 of the prediction layer's."""
    return logits.float().flatten(-2).log_softmax(-1).view(logits.shape)


def jensen_shannon(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """Return the divergence of (..., H, W) maps that sum to 1 (thesis eq. 4.14), in nats."""
    middle = 0.5 * (a + b)
    log_middle = (middle + 1e-12).log()
    return 0.5 * (a * ((a + 1e-12).log() - log_middle) + b * ((b + 1e-12).log() - log_middle)).sum((-2, -1))


def divergence_from_gaussians(u: torch.Tensor, v: torch.Tensor, heatmaps: torch.Tensor) -> torch.Tensor:
    """Return the divergence of (..., S, S) maps from Gaussians about (...) coordinates, looking where the latter are.

    The same as ``jensen_shannon(gaussian_heatmaps(u, v, S), heatmaps)`` but for what Gaussians hold beyond
    ``REACH_SIGMAS``: where one map is 0, the other one's mass counts ``log(2) / 2``.
    """
    a, index = _near(u, v, heatmaps.shape[-1])
    b = heatmaps.flatten(-2).gather(-1, index)
    log_middle = (0.5 * (a + b) + 1e-12).log()
    near = a * ((a + 1e-12).log() - log_middle) + b * ((b + 1e-12).log() - log_middle)
    return 0.5 * (near.sum(-1) + math.log(2.0) * (2.0 - a.sum(-1) - b.sum(-1)))


def relative_entropy(u: torch.Tensor, v: torch.Tensor, log_heatmaps: torch.Tensor) -> torch.Tensor:
    """Return ``KL(G || H) = sum G (log G - log H)``, G Gaussians about (...) coordinates, of (..., S, S) ``log H``.

    Its gradient by a logit is ``H - G``, that of Jensen and Shannon's ``H (log(H / M) - JS) / 2``: nothing wherever a
    map is surely wrong.
    """
    a, index = _near(u, v, log_heatmaps.shape[-1])
    return (a * ((a + 1e-12).log() - log_heatmaps.flatten(-2).gather(-1, index))).sum(-1)


def _near(u: torch.Tensor, v: torch.Tensor, size: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Return Gaussians about (...) coordinates where they hold anything, and which pixels those are, (..., n)."""
    side = min(size, 2 * math.ceil(REACH_SIGMAS * SIGMA_PX) + 1)
    around = torch.arange(side, device=u.device)
    columns, rows = (
        ((c.clamp(-1.0, 1.0) + 1.0) * 0.5 * (size - 1) - side // 2).round().long().clamp(0, size - side)[..., None]
        + around for c in (u, v)
    )  # fmt: skip
    down, across = _profile(v, size).gather(-1, rows), _profile(u, size).gather(-1, columns)
    a = (down[..., :, None] * across[..., None, :]).flatten(-2)
    return a, (size * rows[..., :, None] + columns[..., None, :]).flatten(-2)


def welsch(truth: torch.Tensor, estimate: torch.Tensor, nu: float = WELSCH_NU) -> torch.Tensor:
    """Return ``1 - exp(-|e|² / 2 ν²)`` of (..., 3) normalised positions (thesis eq. 4.15)."""
    return 1.0 - torch.exp(-(truth - estimate).square().sum(-1) / (2.0 * nu**2))
