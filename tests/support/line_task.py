"""A training that takes a moment: a small network learns a line."""

from __future__ import annotations

import torch
from torch import nn

from training.engine.loop import TrainingSettings

SETTINGS = TrainingSettings(steps=40, batch=8, evaluate_every=10, checkpoint_s=0.0)


class LineTask:
    """Learns a line from noisy draws, with dropout so that the global generator counts too."""

    def __init__(self, die_at: int | None = None) -> None:
        torch.manual_seed(1)
        self.model = nn.Sequential(nn.Linear(2, 16), nn.Tanh(), nn.Dropout(0.2), nn.Linear(16, 1))
        self.die_at, self.drawn = die_at, 0

    def draw(self, generator: torch.Generator) -> torch.Tensor:
        self.drawn += 1
        return torch.randn(8, 2, generator=generator)

    def loss(self, batch: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
        if self.drawn - 1 == self.die_at:
            raise KeyboardInterrupt
        x = batch
        return (self.model(x)[:, 0] - x[:, 0] + 2 * x[:, 1]).square().mean()

    def evaluate(self, model: nn.Module) -> dict[str, float]:
        return {"weight": float(next(model.parameters()).detach().sum())}
