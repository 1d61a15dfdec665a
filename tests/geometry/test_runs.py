"""Runs of true values, from the first index to the last."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from solver_backend.geometry.arrays import true_runs


@pytest.mark.parametrize(
    ("mask", "runs"),
    [([], []), ([0, 0], []), ([1, 1], [(0, 1)]), ([1, 0, 1, 1, 0, 1], [(0, 0), (2, 3), (5, 5)])],
)
def test_runs_of_frames(mask: list[int], runs: list[tuple[int, int]]) -> None:
    assert true_runs(np.array(mask, dtype=bool)) == runs


@given(st.lists(st.booleans(), max_size=30))
def test_runs_give_the_mask_back_and_do_not_touch(mask: list[bool]) -> None:
    runs, rebuilt = true_runs(np.array(mask, dtype=bool)), np.zeros(len(mask), dtype=bool)
    for first, last in runs:
        rebuilt[first : last + 1] = True
    assert rebuilt.tolist() == mask
    assert all(later > last + 1 for (_, last), (later, _) in itertools.pairwise(runs))
