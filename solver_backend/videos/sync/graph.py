"""Clocks of all cameras from the lags of their pairs: least squares over the pairs, those that contradict left out."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.videos.sync.clocks import Clocks
from solver_backend.videos.sync.errors import SyncUnknown
from solver_backend.videos.sync.signals import PairLag

CONTRADICTION_S = 0.05
"""A pair's lag this far from what the others measure is wrong."""


def clocks_of_pairs(names: tuple[str, ...], pairs: Mapping[tuple[int, int], PairLag], method: str) -> Clocks:
    """Return the clocks that fit the lags of pairs (i, j) best.

    Pairs enter by their information; the pair that contradicts the rest most is left out until none does. Cameras that
    no pair connects to the first are an error.

    Raises:
        SyncUnknown: a camera is connected by no pair.
    """
    kept, findings = dict(pairs), list[Diagnostic]()
    middle_s = float(np.median([p.middle_s for p in pairs.values()])) if pairs else 0.0
    while True:
        _require_connected(names, kept, method)
        state, covariance = _solved(len(names), kept, middle_s)
        off = {(i, j): abs(_at(p, middle_s) - (state[j, 0] - state[i, 0])) for (i, j), p in kept.items()}
        worst = max(off, key=lambda pair: off[pair])
        without = {pair: p for pair, p in kept.items() if pair != worst}
        if off[worst] < CONTRADICTION_S or not _connected(len(names), without):
            break
        findings.append(diagnostic("clocks_disagree", cameras=[names[c] for c in worst], method=method))
        kept = without
    if off[worst] >= CONTRADICTION_S:
        findings.append(diagnostic("clocks_contradict", method=method, off_ms=1e3 * off[worst]))
    return Clocks(names, state[:, 0], state[:, 1], covariance, middle_s, method, tuple(findings))


def _at(pair: PairLag, middle_s: float) -> float:
    return pair.lag_s + pair.rate * (middle_s - pair.middle_s)


def _solved(count: int, pairs: Mapping[tuple[int, int], PairLag], middle_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Return offsets and rates (C, 2) and covariances (C, 2, 2), the first camera's zero."""
    normal, right = np.zeros((2 * count, 2 * count)), np.zeros(2 * count)
    for (i, j), pair in pairs.items():
        moved = np.array([[1.0, middle_s - pair.middle_s], [0.0, 1.0]])
        information = np.linalg.inv(moved @ pair.covariance @ moved.T)
        rows = np.zeros((2, 2 * count))
        rows[:, 2 * i : 2 * i + 2], rows[:, 2 * j : 2 * j + 2] = -np.eye(2), np.eye(2)
        normal += rows.T @ information @ rows
        right += rows.T @ information @ np.array([_at(pair, middle_s), pair.rate])
    state, covariance = np.zeros((count, 2)), np.zeros((count, 2, 2))
    inverse = np.linalg.inv(normal[2:, 2:])
    state[1:] = (inverse @ right[2:]).reshape(-1, 2)
    for c in range(1, count):
        covariance[c] = inverse[2 * c - 2 : 2 * c, 2 * c - 2 : 2 * c]
    return state, covariance


def _connected(count: int, pairs: Mapping[tuple[int, int], PairLag]) -> set[int]:
    """Return the cameras that are connected to the first if all are, else nothing."""
    reached = {0}
    for _ in range(count):
        reached |= {b for pair in pairs for a, b in (pair, pair[::-1]) if a in reached}
    return reached if len(reached) == count else set()


def _require_connected(names: tuple[str, ...], pairs: Mapping[tuple[int, int], PairLag], method: str) -> None:
    if _connected(len(names), pairs):
        return
    joined = {c for pair in pairs for c in pair}
    alone = [names[c] for c in range(len(names)) if c not in joined] or list(names)
    raise SyncUnknown(
        f"By {method} the cameras cannot be synchronised: nothing in {', '.join(alone)} agrees with another.",
        where=", ".join(names),
        hint="Clap in sight of all cameras and film again, or try another method of --sync.",
    )
