"""The best states of a two-state Markov chain (Viterbi), found for many chains and all frames at once."""

from __future__ import annotations

import numpy as np


def best_states(unary: np.ndarray, transition: np.ndarray) -> np.ndarray:
    """Return the states that minimise ``Σ_f u_f(s_f) + Σ_f T_f(s_{f-1}, s_f)`` (Viterbi 1967).

    The recursion is a product of 2x2 matrices in the (min, +) semiring, which is associative, so that it runs by
    doubling in ``log2 F`` steps (Hillis and Steele 1986) instead of frame by frame. The cheapest state of each frame
    by the cost of the best sequence through it is the best sequence where that is unique; ties go to state 0.

    Args:
        unary: (..., F, 2) cost of each state.
        transition: (..., F, 2, 2) cost of going from the state before to the state at a frame; the first is ignored.

    Returns:
        (..., F) bool, true where the state is 1.
    """
    steps = transition + unary[..., None, :]
    steps[..., 0, :, :] = unary[..., 0, None, :]
    forward = _running_product(steps).min(axis=-2)
    reversed_T = np.swapaxes(transition[..., 1:, :, :] + unary[..., 1:, None, :], -1, -2)[..., ::-1, :, :]
    backward = np.zeros_like(unary)
    backward[..., :-1, :] = _running_product(reversed_T).min(axis=-2)[..., ::-1, :]
    through = forward + backward
    return through[..., 1] < through[..., 0]


def _running_product(matrices: np.ndarray) -> np.ndarray:
    """Return (..., F, 2, 2) products of all matrices up to each, in the (min, +) semiring."""
    product, reach = matrices.copy(), 1
    while reach < product.shape[-3]:
        left, right = product[..., :-reach, :, :], product[..., reach:, :, :]
        through = [left[..., :, state, None] + right[..., None, state, :] for state in (0, 1)]
        product[..., reach:, :, :] = np.minimum(*through)
        reach *= 2
    return product
