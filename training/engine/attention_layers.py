"""Attention layers in torch; ``priors/networks/attention.py`` is their reading side."""

from __future__ import annotations

import torch
from torch import nn


class AttentionLayer(nn.Module):
    """Attention, perhaps with a bias, then two dense layers; normalised before each."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.first, self.second = nn.LayerNorm(width), nn.LayerNorm(width)
        self.qkv, self.out = nn.Linear(width, 3 * width), nn.Linear(width, width)
        self.up, self.down = nn.Linear(width, 2 * width), nn.Linear(2 * width, width)

    def forward(self, x: torch.Tensor, bias: torch.Tensor | None = None) -> torch.Tensor:
        """(B, N, d) -> (B, N, d); the bias is added to scores (B, heads, N, N)."""
        q, k, v = (split_heads(part, self.heads) for part in self.qkv(self.first(x)).chunk(3, -1))
        x = x + self.out(attention(q, k, v, bias))
        return x + self.down(self.up(self.second(x)).relu())


def split_heads(x: torch.Tensor, heads: int) -> torch.Tensor:
    """Return (B, heads, N, d_h) of (B, N, d)."""
    return x.unflatten(-1, (heads, -1)).transpose(1, 2)


def attention(q: torch.Tensor, k: torch.Tensor, v: torch.Tensor, bias: torch.Tensor | None = None) -> torch.Tensor:
    """Return the (B, N, d) values that queries attend to; all are (B, heads, N, d_h)."""
    if bias is None:
        return nn.functional.scaled_dot_product_attention(q, k, v).transpose(1, 2).flatten(-2)
    scores = q @ k.transpose(-1, -2) * q.shape[-1] ** -0.5 + bias
    return (scores.softmax(-1) @ v).transpose(1, 2).flatten(-2)
