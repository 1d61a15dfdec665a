"""Batches of short windows of motion: three keys and a frame between them, as the solver interpolates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from solver_backend.exchange.joint_sets import NUM_JOINTS
from training.data.augmentation import (
    beyond_reach,
    exchanged_limbs,
    maybe_mirrored,
    middle_frame,
    near_limits,
    penetrating,
    varied_joints,
)
from training.data.corpus import Corpus
from training.data.points import rotation_points
from training.data.recombination import ends_reaching, limbs_turned

MAX_SPACING = 9
"""Largest distance of neighbouring keys in frames at 30 Hz (0.3 s)."""


@dataclass(frozen=True)
class WindowBatch:
    """B windows."""

    rotations: torch.Tensor
    """(B, 4, 21, 3, 3): keys at 0, 1/2 and 1, and a frame between."""
    time: torch.Tensor
    """(B,) of the frame between, 0..1."""

    def to(self, device: torch.device) -> WindowBatch:
        """Return the batch on a device."""
        return WindowBatch(self.rotations.to(device), self.time.to(device))


@dataclass(frozen=True)
class WindowSampler:
    """Draws windows around distinct poses of a corpus."""

    rotations: torch.Tensor
    clip_start: torch.Tensor
    clip_end: torch.Tensor
    distinct: torch.Tensor
    exchange_chance: float = 0.6
    variation_chance: float = 0.7
    limit_chance: float = 0.15
    turned_chance: float = 0.0
    """Share of the windows with limbs turned within anatomical limits."""
    end_chance: float = 0.0
    """Share of the windows with ankles, toes and wrists moved towards their ends."""

    @classmethod
    def of(cls, corpus: Corpus, *, turned_chance: float = 0.0, end_chance: float = 0.0) -> WindowSampler:
        """Take a corpus over into torch."""
        rotations, start, end, distinct = (
            torch.as_tensor(np.ascontiguousarray(a))
            for a in (corpus.rotations, corpus.clip_start, corpus.clip_end, corpus.distinct)
        )
        return cls(rotations, start, end, distinct, turned_chance=turned_chance, end_chance=end_chance)

    def draw(self, count: int, generator: torch.Generator) -> WindowBatch:
        """Return ``count`` augmented windows; each has one spacing, shortened where its clip ends."""
        middle = self.distinct[torch.randint(len(self.distinct), (count,), generator=generator)]
        room = torch.minimum(middle - self.clip_start[middle], self.clip_end[middle] - 1 - middle)
        spacing = torch.minimum(torch.randint(1, MAX_SPACING + 1, (count,), generator=generator), room)
        offset = torch.randint(-MAX_SPACING, MAX_SPACING + 1, (count,), generator=generator)
        offset = torch.where(offset.abs() <= spacing, offset, offset % (2 * spacing + 1) - spacing)
        time = 0.5 + 0.5 * offset / spacing.clamp_min(1)
        frames = torch.stack((middle - spacing, middle, middle + spacing, middle + offset), dim=1)
        return WindowBatch(self._augment(self.rotations[frames], generator), time.to(torch.float32))

    def draw_poses(self, count: int, generator: torch.Generator) -> torch.Tensor:
        """Draw ``count`` augmented poses (count, 21, 3, 3) without their motion."""
        chosen = self.distinct[torch.randint(len(self.distinct), (count,), generator=generator)]
        return self._augment(self.rotations[chosen, None], generator)[:, 0]

    def _augment(self, windows: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
        plain = maybe_mirrored(windows, generator)
        mixed = exchanged_limbs(plain, generator, self.exchange_chance)
        vary = torch.rand(len(mixed), 1, 1, 1, 1, generator=generator) < self.variation_chance
        mixed = torch.where(vary, varied_joints(mixed, generator), mixed)
        moved = torch.zeros(len(mixed), dtype=torch.bool)
        for chance, move in (
            (self.turned_chance, limbs_turned), (self.end_chance, ends_reaching), (self.limit_chance, near_limits),
        ):  # fmt: skip
            chosen = torch.rand(len(mixed), generator=generator) < chance
            mixed[chosen] = move(mixed[chosen], generator)
            moved |= chosen
        middle = mixed[:, middle_frame(mixed)]
        bad = penetrating(rotation_points(middle)[:, :NUM_JOINTS])
        bad[moved] |= beyond_reach(middle[moved])
        return torch.where(bad[:, None, None, None, None], plain, mixed)
