from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from solver_backend.videos.detect.detect_videos import least_cost_assignment, tracked


@given(st.integers(1, 5), st.integers(1, 5), st.integers(0, 2**31))
def test_the_assignment_is_the_cheapest_of_all(rows: int, columns: int, seed: int) -> None:
    cost = np.random.default_rng(seed).normal(size=(rows, columns))
    pairs = least_cost_assignment(cost)
    assert len(pairs) == min(rows, columns)
    assert len({i for i, _ in pairs}) == len({j for _, j in pairs}) == len(pairs)
    wide = cost if rows <= columns else cost.T
    best = min(
        sum(wide[i, j] for i, j in enumerate(order))
        for order in itertools.permutations(range(wide.shape[1]), len(wide))
    )
    assert sum(cost[i, j] for i, j in pairs) == pytest.approx(best)


def person(x: float, y: float) -> np.ndarray:
    shape = np.random.default_rng(1).uniform(0, 100, (17, 2))
    return np.column_stack([shape + [x, y], np.ones(17)])


def test_people_keep_their_numbers_while_the_detector_shuffles_them() -> None:
    rng, frames, truth = np.random.default_rng(0), [], []
    for f in range(120):
        # Two people walk past each other at different heights; one leaves in between.
        people = [person(10.0 * f, 0.0), person(1200.0 - 10.0 * f, 60.0)]
        present = [0, 1] if not 40 <= f < 50 else [0]
        order = rng.permutation(present)
        frames.append(np.stack([people[p] for p in order]))
        truth.append(order)
    place, track = tracked(frames, np.arange(120) / 30.0)
    seen = {0: set(), 1: set()}
    for f, order in enumerate(truth):
        for slot in np.flatnonzero(track[f] >= 0):
            seen[int(order[place[f, slot]])].add(int(track[f, slot]))
    assert len(seen[0]) == len(seen[1]) == 1 and seen[0] != seen[1]


def test_who_comes_back_late_is_somebody_new_and_nobody_is_no_error() -> None:
    frames = [person(0, 0)[None], *[np.zeros((0, 17, 3))] * 59, person(0, 0)[None]]
    _, track = tracked(frames, np.arange(61) / 30.0)
    assert track[0].max() == 0 and track[-1].max() == 1 and (track[1:-1] == -1).all()
    assert tracked([], np.zeros(0))[1].shape == (0, 1)
