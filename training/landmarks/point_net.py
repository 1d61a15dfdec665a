"""Our network in torch: attention over the points of a cloud; ``labelling/point_network.py`` is its reading side."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import torch
from torch import nn

from solver_backend.labelling.outputs import GHOST, LANDMARKS, MARKERS
from solver_backend.labelling.point_network import FREQUENCIES, NEARNESS, NEARNESS_WIDTH
from training.engine.attention_layers import AttentionLayer, attention, split_heads

_HIDDEN = -30000.0
"""Score of a point that is not there."""


@dataclass(frozen=True)
class PointNetWidths:
    """Sizes of the network."""

    width: int = 128
    layers: int = 4
    heads: int = 4

    def as_dict(self) -> dict[str, int]:
        """Return the sizes by name."""
        return asdict(self)


@dataclass(frozen=True)
class Reading:
    """What the network returns for B clouds of N points."""

    scores: torch.Tensor
    """(B, N, 54) of each label, ghost last; ``softmax`` over the labels is a point's, over the points a marker's."""
    missing: torch.Tensor
    """(53,) score of a marker that is none of the points."""
    positions: torch.Tensor
    """(B, 77, 3) metres."""
    spread: torch.Tensor
    """(B, 77, 6): log diagonal and lower part of L, the Cholesky factor of a position's precision in 1/dm²."""


class PointNet(nn.Module):
    """Points -> features with a bias by distance in every attention; landmarks ask, points answer."""

    def __init__(self, widths: PointNetWidths = PointNetWidths()) -> None:
        super().__init__()
        self.widths = widths
        d, heads = widths.width, widths.heads
        self.embed = nn.Linear(3 + 6 * len(FREQUENCIES), d)
        self.by_distance = nn.Linear(len(NEARNESS), widths.layers * heads, bias=False)
        self.layers = nn.ModuleList(AttentionLayer(d, heads) for _ in range(widths.layers))
        self.norm = nn.LayerNorm(d)
        self.labels = nn.Linear(d, GHOST + 1)
        self.missing = nn.Parameter(torch.zeros(len(MARKERS)))
        self.queries = nn.Parameter(0.5 * torch.randn(len(LANDMARKS), d))
        self.asking = _Asking(d, heads)
        self.point_at = nn.Linear(d, d, bias=False)
        self.pointed = nn.Linear(d, d, bias=False)
        self.offset = nn.Linear(d, 3)
        self.spread = nn.Linear(d, 6)
        self.register_buffer("frequencies", torch.tensor(FREQUENCIES), persistent=False)
        self.register_buffer("nearness", torch.tensor(NEARNESS), persistent=False)

    def forward(self, points: torch.Tensor, seen: torch.Tensor, asked_of: int | None = None) -> Reading:
        """Read (B, N, 3) points of which ``seen`` (B, N) are there; landmarks ask the first ``asked_of`` clouds."""
        waves = (points[..., None] * self.get_buffer("frequencies")).flatten(-2)
        x = self.embed(torch.cat((points, waves.sin(), waves.cos()), -1))
        apart = (points[:, :, None] - points[:, None]).square().sum(-1).clamp(min=1e-8).pow(0.25)
        near = torch.exp(-((apart[..., None] - self.get_buffer("nearness")) / NEARNESS_WIDTH).square())
        gone = torch.where(seen, 0.0, _HIDDEN)
        bias = self.by_distance(near).permute(0, 3, 1, 2) + gone[:, None, None]
        for layer, part in zip(self.layers, bias.chunk(len(self.layers), dim=1), strict=True):
            x = layer(x, part)
        x = self.norm(x)
        scores = self.labels(x)
        x, gone, points = x[:asked_of], gone[:asked_of], points[:asked_of]
        asked = self.asking(self.queries.expand(len(x), -1, -1), x, gone[:, None, None])
        aim = self.point_at(asked) @ self.pointed(x).transpose(1, 2) * x.shape[-1] ** -0.5 + gone[:, None]
        positions = aim.softmax(-1) @ points + self.offset(asked)
        return Reading(scores, self.missing, positions, self.spread(asked))


class _Asking(nn.Module):
    """Landmarks attend to points, then to one another, then two dense layers."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.q, self.kv, self.out = nn.Linear(width, width), nn.Linear(width, 2 * width), nn.Linear(width, width)
        self.among = AttentionLayer(width, heads)

    def forward(self, asking: torch.Tensor, x: torch.Tensor, bias: torch.Tensor) -> torch.Tensor:
        k, v = (split_heads(part, self.heads) for part in self.kv(x).chunk(2, -1))
        asking = asking + self.out(attention(split_heads(self.q(asking), self.heads), k, v, bias))
        return self.among(asking)
