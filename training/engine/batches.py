"""Batches, each drawn from its own seed, so that processes may draw ahead of the network and change nothing."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import torch
from torch.utils.data import DataLoader, Dataset

Draw = Callable[[torch.Generator], Any]
"""Draws one batch, on the CPU."""
_AHEAD = 4
"""Batches that each process holds ready."""


def step_generator(seed: int, step: int, purpose: int = 0) -> torch.Generator:
    """Return the generator of one step's batch (purpose 0) or of the noise in its loss (purpose 1), on the CPU."""
    words = np.random.SeedSequence((seed, step, purpose)).generate_state(2)
    return torch.Generator().manual_seed(int(words[0]) << 31 ^ int(words[1]))


def batches(draw: Draw, seed: int, first: int, last: int, workers: int) -> Iterator[Any]:
    """Yield the batches of steps ``first`` to ``last - 1``, drawn here, or ahead in ``workers`` processes."""
    if not workers:
        return (draw(step_generator(seed, step)) for step in range(first, last))
    ahead = DataLoader(
        _Steps(draw, seed, first, last), batch_size=None, num_workers=workers, prefetch_factor=_AHEAD,
        generator=torch.Generator(),
    )  # fmt: skip
    return iter(ahead)


class _Steps(Dataset[Any]):
    """The steps as torch's loader asks for them."""

    def __init__(self, draw: Draw, seed: int, first: int, last: int) -> None:
        self._draw, self._seed, self._first, self._last = draw, seed, first, last

    def __len__(self) -> int:
        return self._last - self._first

    def __getitem__(self, index: int) -> Any:
        return self._draw(step_generator(self._seed, self._first + index))
