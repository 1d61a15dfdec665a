"""Noise with a memory, along the frames of axis 1: first-order autoregressive values, and runs of a Markov chain."""

from __future__ import annotations

import numpy as np


def autoregressive(shape: tuple[int, ...], correlation: float, rng: np.random.Generator) -> np.ndarray:
    """Return unit-variance noise of first order, AR(1): ``x_t = a x_{t-1} + sqrt(1 - a²) e_t``.

    Args:
        shape: (C, F, ...).
        correlation: a, between neighbouring frames.
        rng: seeded source of randomness.
    """
    noise = rng.normal(size=shape)
    for f in range(1, shape[1]):
        noise[:, f] = correlation * noise[:, f - 1] + np.sqrt(1 - correlation**2) * noise[:, f]
    return noise


def bursts(draws: np.ndarray, share: float, length: float) -> np.ndarray:
    """Return a mask with runs: a two-state Markov chain, left with ``1 / length``, entered so that ``share`` holds.

    Args:
        draws: (C, F, ...) uniform in 0..1.
        share: mean of the mask.
        length: mean length of a run, frames.
    """
    leave = 1.0 / length
    enter = leave * share / (1.0 - share)
    mask = draws < share
    for f in range(1, draws.shape[1]):
        mask[:, f] = np.where(mask[:, f - 1], draws[:, f] >= leave, draws[:, f] < enter)
    return mask
