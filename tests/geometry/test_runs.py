"""Runs of true values from the first index to the last, and the true values beside each index."""

from __future__ import annotations

import itertools
import tracemalloc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from solver_backend.geometry.arrays import bridges, nearest_true, true_runs


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


@given(st.lists(st.lists(st.booleans(), min_size=2, max_size=2), max_size=12), st.integers(0, 4))
def test_short_gaps_lie_between_the_nearest_true_values(rows: list[list[bool]], longest: int) -> None:
    mask = np.array(rows, dtype=bool).reshape(-1, 2)
    before, after = nearest_true(mask)
    first, last, share = bridges(mask, longest)
    np.testing.assert_array_equal(np.stack(nearest_true(mask.T, axis=1)), np.stack([before.T, after.T]))
    np.testing.assert_array_equal(np.stack(bridges(mask.T, longest, axis=1)), np.stack([first.T, last.T, share.T]))
    for row, column in np.ndindex(mask.shape):
        known = np.flatnonzero(mask[:, column])
        ends = (max(known[known <= row], default=-1), min(known[known >= row], default=len(mask)))
        assert (before[row, column], after[row, column]) == ends
        is_short = not mask[row, column] and ends[0] >= 0 and ends[1] < len(mask) and np.diff(ends) <= longest + 1
        assert (first[row, column], last[row, column]) == (ends if is_short else (row, row))
        assert share[row, column] == ((row - ends[0]) / (ends[1] - ends[0]) if is_short else 0.0)


def test_the_nearest_true_values_need_memory_that_grows_with_frames_only() -> None:
    frames = 100_000
    stands = np.arange(frames) % 3 > 0
    tracemalloc.start()
    before, after = nearest_true(stands)
    assert tracemalloc.get_traced_memory()[1] < 100 * frames
    tracemalloc.stop()
    assert before[:4].tolist() == [-1, 1, 2, 2] and after[-2:].tolist() == [frames - 2, frames]
