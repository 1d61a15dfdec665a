"""The recursion finds what trying every sequence finds."""

from itertools import product

import numpy as np
import pytest

from solver_backend.geometry.arrays import best_states


def cheapest(unary: np.ndarray, transition: np.ndarray) -> np.ndarray:
    def cost(states: tuple[int, ...]) -> float:
        steps = sum(transition[f, states[f - 1], states[f]] for f in range(1, len(states)))
        return steps + sum(unary[f, state] for f, state in enumerate(states))

    return np.array(min(product((0, 1), repeat=len(unary)), key=cost), dtype=bool)


@pytest.mark.parametrize("frames", [1, 2, 3, 7, 10])
def test_it_is_the_cheapest_of_all_sequences(frames):
    rng = np.random.default_rng(frames)
    unary, transition = rng.normal(size=(5, 3, frames, 2)), rng.normal(size=(5, 3, frames, 2, 2))
    before = unary.copy(), transition.copy()
    found = best_states(unary, transition)
    for chain in np.ndindex(5, 3):
        np.testing.assert_array_equal(found[chain], cheapest(unary[chain], transition[chain]))
    np.testing.assert_array_equal(unary, before[0])
    np.testing.assert_array_equal(transition, before[1])


def test_without_evidence_nothing_is_switched():
    assert not best_states(np.zeros((2, 50, 2)), np.zeros((2, 50, 2, 2))).any()
