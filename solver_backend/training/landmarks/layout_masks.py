"""Which places each layout of the data file fills, and how often each is drawn."""

from __future__ import annotations

import numpy as np
import torch

from solver_backend.body.marker_layouts import load_layouts
from solver_backend.training.landmarks.body_points import PLACES

_CHANCES = {"MANIFOLD_53": 0.28, "CMU_41": 0.18, "PLUGIN_GAIT_39": 0.18}
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


PARTS = (
    (0, 1, 2, 4, 5, 7, 8, 10, 11),
    (0, 3, 6, 9, 12, 13, 14, 15, 16, 17, 18, 19, 20, 21, 22, 23),
    (0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 13, 14, 16, 17, 18, 19, 20, 21, 22, 23),
    (0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 15),
    (0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18, 19),
    (0, 2, 3, 5, 6, 8, 9, 11, 12, 15, 14, 17, 19, 21, 23),
)
"""Joints of people with markers on a part of the body alone: legs, no legs, no head, no arms, no hands, one side."""


def part_masks(weights: torch.Tensor) -> torch.Tensor:
    """Return (parts, P) bool: the places of each of ``PARTS``, by each place's heaviest joint in (P, 24) weights."""
    joint = weights.argmax(1)
    return torch.stack([torch.isin(joint, torch.tensor(part, device=joint.device)) for part in PARTS])
