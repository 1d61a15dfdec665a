"""Batches drawn ahead by other processes are the batches of their steps, in order, wherever a run begins."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from tests.support.line_task import SETTINGS, LineTask
from training.engine.loop import batches, run_training, step_generator


def draw(generator: torch.Generator) -> torch.Tensor:
    return torch.rand(3, generator=generator)


@pytest.mark.parametrize("workers", [0, 2])
def test_a_step_has_one_batch_however_it_is_drawn(workers: int) -> None:
    wanted = [draw(step_generator(5, step)) for step in range(12)]
    assert len({tuple(batch.tolist()) for batch in wanted}) == 12
    for first in (0, 7):
        drawn = list(batches(draw, 5, first, 12, workers))
        assert len(drawn) == 12 - first
        assert all(torch.equal(a, b) for a, b in zip(drawn, wanted[first:], strict=True))


def test_seeds_and_purposes_draw_apart() -> None:
    chosen = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
    assert len({tuple(draw(step_generator(*of)).tolist()) for of in chosen}) == 4


def test_processes_change_no_weight_and_a_run_goes_on_with_others(tmp_path: Path) -> None:
    alone = run_training(LineTask(), SETTINGS, tmp_path / "alone")
    with pytest.raises(KeyboardInterrupt):
        run_training(LineTask(17), SETTINGS, tmp_path / "helped")
    helped = run_training(LineTask(), replace(SETTINGS, workers=2), tmp_path / "helped")
    assert all(torch.equal(a, b) for a, b in zip(alone.parameters(), helped.parameters(), strict=True))
