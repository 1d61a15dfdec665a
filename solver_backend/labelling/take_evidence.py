"""How much better two takes of a person agree with two labels of one of them exchanged: by distances, by side."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from solver_backend.labelling.label_like import CAP
from solver_backend.labelling.reference_take import BEND, NEAR_M, RIGID_M, VOLUME, distance_statistics

FRAMES = 120
"""Frames of a take that are looked at."""
LEAST_FRAMES = 8
"""Frames that have to show a marker."""
SKIN_M = 0.01
"""Standard deviation of a rigid pair's distance between takes: markers are put on anew, and skin slides."""
CONFUSED_M = 0.35
"""Distance up to which two markers are taken for each other: the farthest that were, a forearm's for an upper arm's."""
OTHERS = 3
"""Markers beside a pair, the most rigid with both, that show on which side of it they are."""
OPEN = -4.0
"""Where distances speak against an exchange by more than this, sides are not looked at."""


@dataclass(frozen=True)
class TakeShape:
    """What a take shows of M markers: where they are, and how far from each other."""

    points: np.ndarray
    """(F, M, 3) metres, NaN where missing."""
    distance: np.ndarray
    """(M, M) metres, the means; NaN where too few frames show both."""
    variance: np.ndarray
    """(M, M) m², of the distances and of what they change between takes."""

    def columns(self, chosen: np.ndarray) -> TakeShape:
        """Return some of the markers, in this order."""
        pairs = np.ix_(chosen, chosen)
        return TakeShape(self.points[:, chosen], self.distance[pairs], self.variance[pairs])


def shape_of(points: np.ndarray, skin_m: float = SKIN_M) -> TakeShape:
    """Return what (F, M, 3) points show; markers that few frames hold are nowhere."""
    some = points[np.unique(np.linspace(0, len(points) - 1, FRAMES).astype(int))].copy()
    some[:, np.isfinite(some).all(-1).sum(0) < min(LEAST_FRAMES, len(some))] = np.nan
    mean, variance = distance_statistics(some)
    return TakeShape(some, mean, variance + skin_m**2 + (BEND * np.maximum(mean - NEAR_M, 0.0)) ** 2)


def exchange_gains(one: TakeShape, other: TakeShape, pairs: np.ndarray) -> np.ndarray:
    """Return (P,) what exchanging each pair of markers in one take gains, in halves of squared deviations.

    ``Σ_c w_c [q(a, a) + q(b, b) - q(a, b) - q(b, a)]`` with ``q(x, y) = min(½ (d_xc - d'_yc)² / v_c, cap)`` over the
    markers c beside the pair, and the same of triple products, whose sign changes with an exchange. Positive gains
    speak for an exchange.

    Args:
        one: a take of M markers.
        other: another take of the same M markers.
        pairs: (P, 2) numbers of markers.
    """
    a, b = pairs.T
    variance = one.variance + other.variance
    shared = np.maximum(variance[a], variance[b])
    weight = 1.0 / (1.0 + 0.5 * shared / RIGID_M**2)

    def misfit(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.minimum(0.5 * (one.distance[x] - other.distance[y]) ** 2 / shared, CAP)

    gain = weight * (misfit(a, a) + misfit(b, b) - misfit(a, b) - misfit(b, a))
    rows = np.arange(len(pairs))
    gain[rows, a] = gain[rows, b] = 0.0
    total = np.nan_to_num(gain).sum(1)
    rigid = np.nan_to_num(np.minimum(weight, np.where(np.isfinite(shared), weight, 0.0)))
    rigid[rows, a] = rigid[rows, b] = 0.0
    for row in np.flatnonzero(total > OPEN):
        total[row] += _by_side(one, other, pairs[row], rigid[row])
    return total


def replacement_gains(one: TakeShape, other: TakeShape, marker: int, candidates: np.ndarray) -> np.ndarray:
    """Return (K,) what it gains to take another point of one take for a marker that the other take has.

    Args:
        one: a take of M markers and further points.
        other: another take of the same M markers, whose further points are NaN.
        marker: number of the marker.
        candidates: (K,) numbers of further points of the first take.
    """
    shared = other.variance[marker] + one.variance[marker]
    weight = 1.0 / (1.0 + 0.5 * shared / RIGID_M**2)

    def misfit(x: np.ndarray) -> np.ndarray:
        return np.minimum(0.5 * (one.distance[x] - other.distance[marker]) ** 2 / shared, CAP)

    gain = weight * (misfit(np.array([marker])) - misfit(candidates))
    gain[:, marker] = 0.0
    return np.nan_to_num(gain).sum(1)


def _by_side(one: TakeShape, other: TakeShape, pair: np.ndarray, rigid: np.ndarray) -> float:
    """Return what an exchange gains by the side on which the most rigid markers beside the pair are."""
    gain = 0.0
    around = [int(c) for c in np.argsort(-rigid, kind="stable")[:OTHERS] if rigid[c] > 0.1]
    for c, d in combinations(around, 2):
        (here, spread), (there, spread_there) = (_handedness(take.points, pair, c, d) for take in (one, other))
        variance = spread + spread_there + 2.0 * VOLUME**2
        straight, crossed = ((0.5 * (here - sign * there) ** 2 / variance) for sign in (1.0, -1.0))
        gain += min(rigid[c], rigid[d]) * (min(straight, CAP) - min(crossed, CAP))
    return gain


def _handedness(points: np.ndarray, pair: np.ndarray, c: int, d: int) -> tuple[float, float]:
    """Return mean and variance of ``u · (v × w)``: from first to second, from their middle to others."""
    first, second = points[:, pair[0]], points[:, pair[1]]
    middle = 0.5 * (first + second)
    u, v, w = (_unit(part) for part in (second - first, points[:, c] - middle, points[:, d] - middle))
    found = np.einsum("fi,fi->f", u, np.cross(v, w))
    found = found[np.isfinite(found)]
    return (float(found.mean()), float(found.var())) if len(found) >= LEAST_FRAMES else (0.0, np.inf)


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-9)
