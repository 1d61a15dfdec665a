"""Which places each layout of the data file fills, and how often each is drawn."""

from __future__ import annotations

import numpy as np
import torch

from solver_backend.body.marker_layouts import load_layouts
from solver_backend.exchange.body_layout import SMPL
from training.landmarks.body_points import PLACES

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


_HIPS, _LEGS = SMPL.both("hip"), SMPL.both("knee", "ankle", "foot")
_HANDS, _ARMS = SMPL.both("wrist", "hand"), SMPL.both("shoulder", "elbow", "wrist", "hand")
_EVERY = range(SMPL.num_joints)
_LEFT = (*SMPL.group("left_leg"), *SMPL.group("left_arm"), *SMPL.group("left_hand"))
PARTS = tuple(
    tuple(joint for joint in _EVERY if joint not in lacking)
    for lacking in (
        {joint for joint in _EVERY if joint not in (0, *_HIPS, *_LEGS)}, {*_HIPS, *_LEGS},
        set(SMPL.numbers("neck", "head")), {*SMPL.both("collar"), *_ARMS}, set(_HANDS), set(_LEFT),
    )
)  # fmt: skip
"""Joints of people with markers on a part of the body alone: legs, no legs, no head, no arms, no hands, one side."""


def part_masks(weights: torch.Tensor) -> torch.Tensor:
    """Return (parts, P) bool: the places of each of ``PARTS``, by each place's heaviest joint in (P, 24) weights."""
    joint = weights.argmax(1)
    return torch.stack([torch.isin(joint, torch.tensor(part, device=joint.device)) for part in PARTS])
