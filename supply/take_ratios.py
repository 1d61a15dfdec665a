"""Compute the ratios of two methods' errors over takes, with a bootstrap interval."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

DRAWS, LEVEL = 10_000, 0.95  # Number of draws of the bootstrap, and level of its interval.
Ratios = dict[str, float]  # Ratios by take.


def take_ratios(runs: Mapping[str, Any], over: str, under: str, column: str) -> Ratios:
    """Return the ratio of two methods' figures for each take that both solved, as a median over seeds.

    The ratio is infinite if the denominator is 0.

    Args:
        runs: figures by method, take, seed and column.
        over: name of the method in the numerator.
        under: name of the method in the denominator.
        column: name of the figure.
    """
    ratios = {}
    for take, rows in runs[over].items():
        others = runs[under].get(take, {})
        pairs = [(row.get(column), others.get(seed, {}).get(column)) for seed, row in rows.items()]
        known = [a / b if b else np.inf for a, b in pairs if None not in (a, b) and (a or b)]
        if known:
            ratios[take] = float(np.median(known))
    return ratios


def interval(ratios: Ratios) -> tuple[float, float, float]:
    """Return the median of the takes' ratios, and its 95 % bootstrap interval over takes.

    Reference: Efron 1979 (percentile intervals).
    """
    values = np.array(list(ratios.values()))
    drawn = np.random.default_rng(0).choice(values, (DRAWS, len(values)))
    low, high = np.quantile(np.median(drawn, axis=1), [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    return float(np.median(values)), float(low), float(high)


def take_medians(runs: Mapping[str, Any], method: str, column: str) -> dict[str, float]:
    """Return a method's figure for every take that it solved, as a median over seeds."""
    known = {take: [row[column] for row in rows.values() if column in row] for take, rows in runs[method].items()}
    return {take: float(np.median(values)) for take, values in known.items() if values}
