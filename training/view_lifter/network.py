"""The view lifter in torch: attention among the frames of a window; ``priors/view_lifter.py`` is its reading side."""

from __future__ import annotations

import torch
from torch import nn

from solver_backend.priors.view_lifter import MIDDLE, OUTPUTS, TOKEN, WINDOW
from training.engine.attention_layers import AttentionLayer


class ViewNet(nn.Module):
    """(N, 27, 62) features to (N, 89)."""

    def __init__(self, width: int, layers: int, heads: int) -> None:
        super().__init__()
        self.embed = nn.Linear(TOKEN, width)
        self.place = nn.Parameter(0.1 * torch.randn(WINDOW, width))
        self.layers = nn.ModuleList(AttentionLayer(width, heads) for _ in range(layers))
        self.norm = nn.LayerNorm(width)
        self.out = nn.Linear(width, OUTPUTS)

    def forward(self, tokens: torch.Tensor) -> torch.Tensor:
        """Read the middle of each window."""
        x = self.embed(tokens) + self.place
        for layer in self.layers:
            x = layer(x)
        return self.out(self.norm(x[:, MIDDLE]))
