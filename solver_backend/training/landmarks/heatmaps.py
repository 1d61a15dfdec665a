"""Heatmaps of landmarks: drawn, read by their centre of mass, fused by the shared axis, and compared (4.14, 4.15)."""

from __future__ import annotations

import torch

SIGMA_PX = 2.0
"""Spread of a drawn heatmap."""
WELSCH_NU = 0.05
JS_SHARE, WELSCH_SHARE = 1.0, 1.0


def gaussian_heatmaps(u: torch.Tensor, v: torch.Tensor, size: int) -> torch.Tensor:
    """Return (..., size, size) maps that sum to 1, about unquantised (...) coordinates in -1..1; rows along v."""
    pixels = torch.linspace(-1.0, 1.0, size, device=u.device)
    sigma = 2.0 * SIGMA_PX / (size - 1)
    across, down = (
        torch.softmax(-0.5 * ((pixels - c.clamp(-1.0, 1.0)[..., None]) / sigma).square(), -1) for c in (u, v)
    )
    return down[..., :, None] * across[..., None, :]


def expectations(heatmaps: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the centres of mass, along columns and rows, of (..., H, W) maps that sum to 1."""
    pixels = torch.linspace(-1.0, 1.0, heatmaps.shape[-1], device=heatmaps.device)
    return (heatmaps.sum(-2) * pixels).sum(-1), (heatmaps.sum(-1) * pixels).sum(-1)


def fused(heatmaps: torch.Tensor) -> torch.Tensor:
    """Return (B, L, 3) normalised positions of (B, 2, L, H, W) maps of the xy and yz views; y is the mean of both."""
    across, down = expectations(heatmaps)
    return torch.stack((across[:, 0], 0.5 * (down[:, 0] + down[:, 1]), across[:, 1]), -1)


def normalised(logits: torch.Tensor) -> torch.Tensor:
    """Return (..., H, W) maps that sum to 1 of the prediction layer's."""
    return logits.float().flatten(-2).softmax(-1).view(logits.shape)


def jensen_shannon(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """Return the divergence of (..., H, W) maps that sum to 1 (thesis eq. 4.14), in nats."""
    middle = 0.5 * (a + b)
    log_middle = (middle + 1e-12).log()
    return 0.5 * (a * ((a + 1e-12).log() - log_middle) + b * ((b + 1e-12).log() - log_middle)).sum((-2, -1))


def welsch(truth: torch.Tensor, estimate: torch.Tensor, nu: float = WELSCH_NU) -> torch.Tensor:
    """Return ``1 - exp(-|e|² / 2 ν²)`` of (..., 3) normalised positions (thesis eq. 4.15)."""
    return 1.0 - torch.exp(-(truth - estimate).square().sum(-1) / (2.0 * nu**2))
