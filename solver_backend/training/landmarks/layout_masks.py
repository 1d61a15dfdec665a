"""Which places each layout of the data file fills, and how often each is drawn."""

from __future__ import annotations

import numpy as np
import torch

from solver_backend.body.marker_layouts import load_layouts
from solver_backend.training.landmarks.body_points import PLACES

_CHANCES = {"MANIFOLD_53": 0.3, "CMU_41": 0.22, "PLUGIN_GAIT_39": 0.22}
"""Chance of each layout; those of other systems share the rest."""


def layout_masks(device: str) -> tuple[torch.Tensor, torch.Tensor]:
    """Return (layouts, P) bool and the (layouts,) cumulated chances."""
    file = load_layouts()
    masks, chances = [], []
    rest = (1.0 - sum(_CHANCES.values())) / len(file.label_sets)
    for name, labels in (*file.layouts.items(), *file.label_sets.items()):
        filled = {file.place_of(label) for label in labels}
        masks.append([place in filled for place in PLACES])
        chances.append(_CHANCES.get(name, rest))
    cumulated = torch.tensor(np.cumsum(chances), dtype=torch.float32, device=device)
    return torch.tensor(masks, device=device), cumulated
