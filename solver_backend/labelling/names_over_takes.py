"""Markers with swapped names in one take of a person."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from solver_backend.body.body import load_body
from solver_backend.body.marker_names import is_unnamed, name_markers
from solver_backend.body.markers import marker_landmarks
from solver_backend.geometry.small_matrices import unit
from solver_backend.labelling.label_like import BEND, CAP, NEAR_M, RIGID_M, VOLUME, distance_statistics
from solver_backend.types import MarkerCloud

FRAMES, LEAST_FRAMES = 120, 8  # Most frames of a take to use, and least frames that show a marker.
SKIN_M = 0.01  # Standard deviation of a rigid pair's distance between takes: markers are put on anew, and skin slides.
CONFUSED_M = 0.35
"""Largest distance of two markers that are confused: the farthest that were, a forearm's and an upper arm's."""
OTHERS = 3  # Further markers, the most rigid with both of a pair, that show its side.
OPEN = -4.0  # Gain by distances below which sides are not compared.


@dataclass(frozen=True)
class TakeShape:
    """Places and distances of M markers in a take."""

    points: np.ndarray  # (F, M, 3) metres, NaN where missing.
    distance: np.ndarray  # (M, M) metres, the means, NaN where too few frames show both.
    variance: np.ndarray  # (M, M) m², of the distances and of their changes between takes.


def shape_of(points: np.ndarray, skin_m: float = SKIN_M) -> TakeShape:
    """Return the shape of (F, M, 3) points. Markers that few frames show are missing."""
    some = points[np.unique(np.linspace(0, len(points) - 1, FRAMES).astype(int))].copy()
    some[:, np.isfinite(some).all(-1).sum(0) < min(LEAST_FRAMES, len(some))] = np.nan
    mean, variance = distance_statistics(some)
    return TakeShape(some, mean, variance + skin_m**2 + (BEND * np.maximum(mean - NEAR_M, 0.0)) ** 2)


def exchange_gains(one: TakeShape, other: TakeShape, pairs: np.ndarray) -> np.ndarray:
    """Return (P,) gains of exchanging each of (P, 2) pairs of markers in one take, in halves of squared deviations.

    ``Σ_c w_c [q(a, a) + q(b, b) - q(a, b) - q(b, a)]`` with ``q(x, y) = min(½ (d_xc - d'_yc)² / v_c, cap)`` over the
    other markers c, and the same of triple products, which change their sign with an exchange. Both takes show the same
    M markers.
    """
    a, b = pairs.T
    variance = one.variance + other.variance
    shared = np.maximum(variance[a], variance[b])
    weight = 1.0 / (1.0 + 0.5 * shared / RIGID_M**2)

    def misfit(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return _misfit(one, other, x, y, shared)

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
    """Return (K,) gains of taking another point of one take (a candidate's number) for a marker of the other take.

    The first take has M markers and further points, the other one the same markers and NaN for the further points.
    """
    shared = other.variance[marker] + one.variance[marker]
    weight = 1.0 / (1.0 + 0.5 * shared / RIGID_M**2)
    before, after = (_misfit(one, other, x, marker, shared) for x in (np.array([marker]), candidates))
    gain = weight * (before - after)
    gain[:, marker] = 0.0
    return np.nan_to_num(gain).sum(1)


def _misfit(one: TakeShape, other: TakeShape, x: np.ndarray, y: np.ndarray | int, variance: np.ndarray) -> np.ndarray:
    return np.minimum(0.5 * (one.distance[x] - other.distance[y]) ** 2 / variance, CAP)


def _by_side(one: TakeShape, other: TakeShape, pair: np.ndarray, rigid: np.ndarray) -> float:
    """Return the gain of an exchange by the side of the most rigid other markers."""
    gain = 0.0
    around = [int(c) for c in np.argsort(-rigid, kind="stable")[:OTHERS] if rigid[c] > 0.1]
    for c, d in combinations(around, 2):
        (here, spread), (there, spread_there) = (_handedness(take.points, pair, c, d) for take in (one, other))
        variance = spread + spread_there + 2.0 * VOLUME**2
        straight, crossed = ((0.5 * (here - sign * there) ** 2 / variance) for sign in (1.0, -1.0))
        gain += min(rigid[c], rigid[d]) * (min(straight, CAP) - min(crossed, CAP))
    return gain


def _handedness(points: np.ndarray, pair: np.ndarray, c: int, d: int) -> tuple[float, float]:
    """Return mean and variance of ``u · (v × w)``: from first to second, and from their middle to two others."""
    first, second = points[:, pair[0]], points[:, pair[1]]
    middle = 0.5 * (first + second)
    u, v, w = (unit(part) for part in (second - first, points[:, c] - middle, points[:, d] - middle))
    found = np.einsum("fi,fi->f", u, np.cross(v, w))
    found = found[np.isfinite(found)]
    return (float(found.mean()), float(found.var())) if len(found) >= LEAST_FRAMES else (0.0, np.inf)


CLEAR, CLEAR_OF_TWO = 3.0, 6.0
"""Least gain of an exchange against every other take (see ``exchange_gains``), and where the layout decides. Of five
takes each of UI-PRMD's eight people, rightly named, none gains more than 1.3 against all others, and 2 to 22 against a
single one; C7 and T10 exchanged gain at least 23, LUPA and LFRM 5, knee and shank 2, wrists -8 to 8."""
CLEAR_BY_LAYOUT = 3.0  # Least gain against the layout's places, where as many takes are for an exchange as against it.
ROUNDS = 12  # Most exchanges in one take: takes are compared again after each.
MOST_TOGETHER, BESIDE = 12, 3
"""Most takes that are compared in pairs, and the number of them that each further one is compared with."""
_PLACED_M = 0.03  # Standard deviation of the distance between two markers at known places of a layout.


@dataclass(frozen=True)
class NameChange:
    """Two names that are swapped in one take."""

    take: int  # Number of the take, from 0.
    first: str
    second: str  # Labels, or the former label of a point without a name that takes the first one.
    mended: bool  # False where the takes do not decide which name is right. The names are then left.


@dataclass(frozen=True)
class NamesOverTakes:
    """Takes of one person under the same names."""

    clouds: tuple[MarkerCloud, ...]
    changes: tuple[NameChange, ...]


def names_over_takes(clouds: Sequence[MarkerCloud], kept: Collection[str] = ()) -> NamesOverTakes:
    """Return takes of one person with equal names of equal markers.

    Two takes contradict each other about a pair of labels where exchanging it makes their distances and sides agree.
    A take that all others contradict, while they agree among themselves, is corrected. Where as many takes are for one
    as for the other, the layout's places decide. Where these do not either, the names are left and reported.

    The user's labels (``kept``) are not changed. Each column of the takes is one marker throughout.
    """
    takes, mended = list(clouds), list[NameChange]()
    if len(takes) < 2 or any(cloud.labels is None for cloud in takes):
        return NamesOverTakes(tuple(takes), ())
    if len(takes) > MOST_TOGETHER:
        return _of_many(takes, kept)
    for _ in range(ROUNDS):
        found = _changes(takes, kept)
        # One at a time in each take: with one pair exchanged, what stands around it seems to be the other way round.
        first = {change.take: change for change in reversed(found) if change.mended and change not in mended}
        for change in first.values():
            takes[change.take] = with_exchanged(takes[change.take], change.first, change.second)
        mended += first.values()
        if not first:
            return NamesOverTakes(tuple(takes), (*mended, *(change for change in found if not change.mended)))
    return NamesOverTakes(tuple(takes), tuple(mended))


def _of_many(takes: list[MarkerCloud], kept: Collection[str]) -> NamesOverTakes:
    """Compare some of many takes with each other, and the others with a few of these."""
    chosen = np.unique(np.linspace(0, len(takes) - 1, MOST_TOGETHER).astype(int)).tolist()
    found = names_over_takes([takes[i] for i in chosen], kept)
    changes = [replace(change, take=chosen[change.take]) for change in found.changes]
    for i, cloud in zip(chosen, found.clouds, strict=True):
        takes[i] = cloud
    beside = [takes[i] for i in chosen[:BESIDE]]
    for i in sorted(set(range(len(takes))) - set(chosen)):
        one = names_over_takes([*beside, takes[i]], kept)
        changes += [replace(change, take=i) for change in one.changes if change.take == BESIDE]
        takes[i] = one.clouds[BESIDE]
    return NamesOverTakes(tuple(takes), tuple(changes))


def _changes(takes: Sequence[MarkerCloud], kept: Collection[str]) -> list[NameChange]:
    """Return changes that share no label in a take, the clearest first."""
    count = Counter(name for cloud in takes for name in {*cloud.names})
    labels = sorted(label for label in count if count[label] > 1 and not is_unnamed(label))
    shapes = [shape_of(_points_of(cloud, labels)) for cloud in takes]
    nearest = np.min([np.nan_to_num(shape.distance, nan=np.inf) for shape in shapes], axis=0)
    pairs = np.argwhere(np.triu(nearest < CONFUSED_M, 1))
    shown = np.array([np.isfinite(shape.distance).sum(1) > 1 for shape in shapes])[:, pairs].all(-1)
    gains = np.full((len(takes), len(takes), len(pairs)), np.nan)
    for s, t in combinations(range(len(takes)), 2):
        gains[s, t] = np.where(shown[s] & shown[t], exchange_gains(shapes[s], shapes[t], pairs), np.nan)
        gains[t, s] = gains[s, t]
    places = _places(labels)
    by_layout = np.stack([exchange_gains(shape, places, pairs) for shape in shapes])
    found: list[tuple[float, NameChange]] = []
    for p, (a, b) in enumerate(pairs):
        if not {labels[a], labels[b]} & set(kept):
            for take, clear, mended in _odd_takes(gains[..., p], by_layout[:, p]):
                found.append((clear, NameChange(take, labels[a], labels[b], mended)))
    found += _replacements(takes, labels, shapes, places, kept)
    chosen: list[NameChange] = []
    for _, change in sorted(found, key=lambda item: -item[0]):
        mine = {change.first, change.second}
        if not any(other.take == change.take and mine & {other.first, other.second} for other in chosen):
            chosen.append(change)
    return chosen


def _odd_takes(gain: np.ndarray, by_layout: np.ndarray) -> list[tuple[int, float, bool]]:
    """Return the takes with two swapped names, how clearly, and whether that is sure.

    Gains of an exchange are (T, T) between two takes, NaN if one of them does not show both markers, and (T,) against
    the layout's places.
    """
    there = np.flatnonzero(np.isfinite(gain).any(1))
    between = gain[np.ix_(there, there)]
    if len(there) < 2 or not (between > CLEAR).any():
        return []
    seed = int(np.argmax((between > CLEAR).sum(axis=1)))
    odd = ~(between[seed] > 0.0)
    across = between[np.ix_(odd, ~odd)]
    within = [between[np.ix_(group, group)] for group in (odd, ~odd)]
    clear = float(np.nanmin(across)) if np.isfinite(across).any() else 0.0
    agree = not any((part > 0.0).any() for part in within)
    doubtful = clear > 0.5 * CLEAR and np.nanmax(across, initial=-np.inf) > CLEAR_OF_TWO
    if not agree or not (doubtful or clear > CLEAR):
        return []
    few, many = (odd, ~odd) if odd.sum() <= (~odd).sum() else (~odd, odd)
    if few.sum() < many.sum():
        return [(int(take), clear, clear > CLEAR) for take in there[few]]
    one, other = (float(np.mean(by_layout[there[group]])) for group in (few, many))
    sure = clear > CLEAR_OF_TWO and min(one, other) < -CLEAR_BY_LAYOUT and max(one, other) > CLEAR_BY_LAYOUT
    return [(int(take), clear, sure) for take in there[few if one > other else many]]


def _replacements(
    takes: Sequence[MarkerCloud],
    labels: list[str],
    shapes: Sequence[TakeShape],
    places: TakeShape,
    kept: Collection[str],
) -> list[tuple[float, NameChange]]:
    """Return names that another point of a take should have, with a label of its own."""
    count, found = len(takes), list[tuple[float, NameChange]]()
    points = [[label for label in cloud.names if label not in labels] for cloud in takes]
    whole = [shape_of(_points_of(cloud, [*labels, *more])) for cloud, more in zip(takes, points, strict=True)]
    for m, label in enumerate(labels):
        there = [t for t in range(count) if np.isfinite(shapes[t].distance[m]).any()]
        near = {t: len(labels) + np.flatnonzero(whole[t].distance[m, len(labels) :] < CONFUSED_M) for t in there}
        near = {t: columns for t, columns in near.items() if len(columns)}
        if label in kept or len(there) < 2 or not near:
            continue
        gains = {
            (t, s): replacement_gains(whole[t], _padded(other, len(points[t])), m, columns)
            for t, columns in near.items()
            for s, other in [*((s, shapes[s]) for s in there if s != t), (-1, places)]
        }
        best = {key: float(values.max()) for key, values in gains.items()}
        against = np.full((count, count), np.nan)
        for t, s in combinations(there, 2):
            against[t, s] = against[s, t] = max(best.get((t, s), -np.inf), best.get((s, t), -np.inf))
        by_layout = np.array([best.get((t, -1), 0.0) for t in range(count)])
        odd = {take: (clear, sure) for take, clear, sure in _odd_takes(against, by_layout)}
        for t, (clear, sure) in odd.items():
            rest = [gains[t, s] for s in there if s not in odd and (t, s) in gains]
            least = np.min(rest, axis=0) if rest else np.zeros(0)
            fits = bool(least.size) and float(least.max()) > CLEAR
            other = points[t][near[t][int(np.argmax(least))] - len(labels)] if fits else ""
            found.append((clear, NameChange(t, label, other, mended=sure and fits)))
    return found


def _padded(shape: TakeShape, more: int) -> TakeShape:
    distance, variance = (
        np.pad(part, ((0, more), (0, more)), constant_values=np.nan) for part in (shape.distance, shape.variance)
    )
    return replace(shape, distance=distance, variance=variance)


def _points_of(cloud: MarkerCloud, labels: Sequence[str]) -> np.ndarray:
    found = np.full((len(cloud.positions), len(labels), 3), np.nan)
    own = {label: column for column, label in enumerate(cloud.names)}
    there = [i for i, label in enumerate(labels) if label in own]
    found[:, there] = cloud.positions[:, [own[labels[i]] for i in there]]
    return found


def _places(labels: Sequence[str]) -> TakeShape:
    """Return the layouts' places on the average body, NaN where they have none."""
    body, known = load_body(), name_markers(labels).known
    named = [i for i, label in enumerate(labels) if known.get(label, "@")[0] != "@"]
    points = np.full((LEAST_FRAMES, len(labels), 3), np.nan)
    if named:
        points[:, named] = marker_landmarks(body, tuple(known[labels[i]] for i in named)).anchors.sum(axis=1)
    return shape_of(points, _PLACED_M)


def with_exchanged(cloud: MarkerCloud, first: str, second: str) -> MarkerCloud:
    """Return a take with two labels exchanged."""
    swapped = {first: second, second: first}
    return replace(cloud, labels=tuple(swapped.get(label, label) for label in cloud.names))
