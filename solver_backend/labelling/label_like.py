"""Transfer labels between takes of the same person, and find labels that were swapped between takes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from solver_backend.agreement.evidence import BOUND
from solver_backend.body.body import load_body
from solver_backend.body.marker_names import is_unnamed, name_markers
from solver_backend.body.markers import marker_landmarks
from solver_backend.exchange.errors import NoDetections
from solver_backend.geometry.small_matrices import unit
from solver_backend.labelling.tracklets import Tracklets, tracklets_of
from solver_backend.types import MarkerCloud

FRAMES, LEAST_COMMON = 240, 5
"""Largest number of frames used from a take, and smallest number of frames that must show both markers of a pair."""
FLOOR_M, NEAR_M, BEND = 0.008, 0.12, 0.15
"""Standard deviation (m) of the distance between a rigid pair due to soft tissue, and its relative increase with the
distance beyond ``NEAR_M``, because another take may bend joints that do not move in this one."""
RIGID_M = 0.02  # Standard deviation in metres at which a pair has half weight.
VOLUME = 0.12  # Additional standard deviation between takes for a triple product of unit vectors.


@dataclass(frozen=True)
class ReferenceTake:
    """Statistics of a labelled take with L markers: their distances and orientations relative to each other."""

    labels: tuple[str, ...]
    distance: np.ndarray  # (L, L) mean distances in metres, NaN for pairs that are never visible together.
    variance: np.ndarray  # (L, L) variances in m².
    weight: np.ndarray  # (L, L) weight of each pair, 0 to 1, with 0 on the diagonal.
    points: np.ndarray  # (F, L, 3) positions in metres.

    def volume(self, label: int, others: np.ndarray) -> tuple[float, float]:
        """Return mean and variance of the triple product of the unit vectors from a marker to three others."""
        found = triple_products(self.points[:, label], self.points[:, others])
        found = found[np.isfinite(found)]
        return (float(found.mean()), float(found.var()) + VOLUME**2) if found.size else (0.0, np.inf)


def reference_of(cloud: MarkerCloud) -> ReferenceTake:
    """Measure the distances and orientations between the markers of a labelled take."""
    some = np.unique(np.linspace(0, len(cloud.positions) - 1, FRAMES).astype(int))
    points = cloud.positions[some]
    mean, variance = distance_statistics(points)
    spread = variance + FLOOR_M**2 + (BEND * np.maximum(mean - NEAR_M, 0.0)) ** 2
    weight = np.nan_to_num(1.0 / (1.0 + spread / RIGID_M**2))
    np.fill_diagonal(weight, 0.0)
    return ReferenceTake(cloud.names, mean, spread, weight, points)


def distance_statistics(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return means and variances (N, N) of the distances between points, NaN for pairs rarely visible together."""
    count = points.shape[1]
    total, square, seen = (np.zeros((count, count)) for _ in range(3))
    for frame in points:
        distance = np.linalg.norm(frame[:, None] - frame[None], axis=-1)
        there = np.isfinite(distance)
        distance = np.where(there, distance, 0.0)
        total, square, seen = total + distance, square + distance**2, seen + there
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.where(seen >= LEAST_COMMON, total / seen, np.nan)
        return mean, np.maximum(square / seen - mean**2, 0.0)


def triple_products(points: np.ndarray, others: np.ndarray) -> np.ndarray:
    """For each point (..., 3), return the triple product (...) of its unit vectors to three ``others`` (..., 3, 3)."""
    along = unit(others - points[..., None, :])
    return np.einsum("...i,...i->...", along[..., 0, :], np.cross(along[..., 1, :], along[..., 2, :]))


BEAM, FIRST_BEAM, SEED = 150, 3000, 5  # Number of hypotheses, also while fewer than ``SEED`` labels are assigned.
CAP, SKIP = 6.0, 2.0
"""Largest cost of a pair in half squared deviations, which applies to a bent joint or a wrong pair, and cost of a pair
without a point for its label. A correct pair costs 0.5."""
VOLUMES, VOLUME_WEIGHT = 3, 3.0  # Triple products per new label, and the weight of each relative to a rigid pair.
FITS, CLEAR = 4.0, 0.2
"""Largest mean cost at which a label fits a tracklet, and smallest cost difference to the next label."""
SAMPLES, ROUNDS = 24, 6  # Frames used from a tracklet, and rounds in which labels propagate.


@dataclass(frozen=True)
class LikeTake:
    """Labels of a take that were transferred from a reference take."""

    tracklets: Tracklets
    chain_label: np.ndarray  # (C,) label of each chain of tracklets, -1 if no label is certain.
    labels: tuple[str, ...]  # Labels in the reference.

    @property
    def point_labels(self) -> np.ndarray:
        """(F, N) label of each point, -1 if it has none."""
        number = self.tracklets.number
        return np.where(number >= 0, self.chain_label[self.tracklets.chain][number], -1)

    def cloud(self, source: MarkerCloud) -> MarkerCloud:
        """Return the take with one column per label, followed by the unlabelled points."""
        found, frames = self.point_labels, len(source.positions)
        named = np.full((frames, len(self.labels), 3), np.nan)
        f, n = np.nonzero(found >= 0)
        named[f, found[f, n]] = source.positions[f, n]
        rest = np.where((found < 0)[..., None], source.positions, np.nan)
        rest = rest[:, np.isfinite(rest).all(-1).any(0)]
        labels = (*self.labels, *(f"*{i}" for i in range(rest.shape[1])))
        return MarkerCloud(np.concatenate([named, rest], axis=1), source.fps, labels)


def label_like(
    cloud: MarkerCloud, reference: ReferenceTake, *, persistent: bool = False, proposed: np.ndarray | None = None
) -> LikeTake:
    """Label a take's points like a labelled take of the same person.

    In the frame with the most points, a beam search assigns the labels. It starts with the most rigid markers, as the
    distances between markers on one bone are constant. Triple products exclude mirror images. Labels then propagate in
    time: a tracklet gets a label if no other label fits its distances to the labelled points.

    Args:
        cloud: points to label. Their names are ignored.
        persistent: each column is one marker throughout.
        proposed: (F, N) the network's labels (-1 for none), tried as a second initial labelling. The better fit wins.

    Raises:
        NoDetections: no frame shows enough of the points.
    """
    tracklets = tracklets_of(cloud.positions, cloud.fps, persistent=persistent)
    tracks = np.full((len(cloud.positions), tracklets.num_chains, 3), np.nan)
    f, n = np.nonzero(tracklets.number >= 0)
    tracks[f, tracklets.chain[tracklets.number[f, n]]] = cloud.positions[f, n]
    alive = np.isfinite(tracks[..., 0])
    length = np.minimum(alive.sum(0), 2.0 * cloud.fps)
    start = int(np.argmax(alive @ length))
    chains = np.flatnonzero(alive[start])
    if len(chains) < SEED:
        raise NoDetections("No frame has enough points to label.", hint="Choose another recording.")
    around = slice(max(0, start - int(2 * cloud.fps)), start + int(2 * cloud.fps) + 1)
    found = np.full(tracks.shape[1], -1)
    found[chains] = _lay(tracks[around][:, chains], tracks[start, chains], reference)
    starts = [found]
    if proposed is not None:
        votes = np.zeros((tracklets.num_chains, len(reference.labels)))
        f, n = np.nonzero((tracklets.number >= 0) & (proposed >= 0))
        np.add.at(votes, (tracklets.chain[tracklets.number[f, n]], proposed[f, n]), 1.0)
        starts.append(np.where(votes.any(1), votes.argmax(1), -1))
    results = [_spread(tracks, alive, first, reference) for first in starts]
    best, _ = max(results, key=lambda result: result[1])
    return LikeTake(tracklets, best, reference.labels)


def _lay(points: np.ndarray, now: np.ndarray, reference: ReferenceTake) -> np.ndarray:
    """Label the points ``now`` (N, 3) of one frame by a beam search. Return one label per point, -1 for none.

    The distances between the points are measured over the neighbouring frames ``points`` (F, N, 3).
    """
    some = np.unique(np.linspace(0, len(points) - 1, 60).astype(int))
    mean, variance = distance_statistics(points[some])
    at_once = np.linalg.norm(now[:, None] - now[None], axis=-1)
    mean, variance = np.where(np.isfinite(mean), mean, at_once), np.nan_to_num(variance)
    order = _order(reference)
    laid = np.full((1, 0), -1)
    cost = np.zeros(1)
    for k, label in enumerate(order):
        weight = reference.weight[label, order[:k]]
        added = np.zeros((len(laid), len(now)))
        for i in range(k):
            if weight[i] <= 0.02:
                continue
            d, v = reference.distance[label, order[i]], reference.variance[label, order[i]]
            row = np.minimum(0.5 * ((mean - d) ** 2 + variance) / v, CAP)
            there = laid[:, i] >= 0
            added += weight[i] * np.where(there[:, None], row[laid[:, i]], SKIP)
        added += _volumes(now, laid, order[:k], label, reference)
        taken = (laid[:, :, None] == np.arange(len(now))).any(1)
        skip = SKIP * weight.sum() + (1.0 if k else 100.0)
        options = np.concatenate([np.where(taken, np.inf, added), np.full((len(laid), 1), skip)], axis=1)
        totals = (cost[:, None] + options).ravel()
        width = FIRST_BEAM if k < SEED else BEAM
        best = np.argsort(totals, kind="stable")[:width]
        best = best[np.isfinite(totals[best])]
        rows, columns = np.divmod(best, len(now) + 1)
        new = np.where(columns == len(now), -1, columns)
        laid, cost = np.concatenate([laid[rows], new[:, None]], axis=1), totals[best]
    found = np.full(len(now), -1)
    there = laid[0] >= 0
    found[laid[0, there]] = order[there]
    return found


def _order(reference: ReferenceTake) -> np.ndarray:
    weight = reference.weight
    first = int(np.argmax(np.sort(weight, axis=1)[:, -4:].sum(1)))
    order, left = [first], set(range(len(weight))) - {first}
    while left:
        bound = {j: np.sort(weight[j, order])[-3:].sum() for j in left}
        order.append(max(sorted(left), key=bound.__getitem__))
        left.remove(order[-1])
    return np.array(order)


def _volumes(now: np.ndarray, laid: np.ndarray, before: np.ndarray, label: int, reference: ReferenceTake) -> np.ndarray:
    """Return the costs (B, N) of ``label`` for each of N points in B hypotheses, by comparing triple products."""
    added = np.zeros((len(laid), len(now)))
    if len(before) < 3:
        return added
    rigid = np.argsort(-reference.weight[label, before], kind="stable")[: 2 + VOLUMES]
    for third in range(2, len(rigid)):
        three = rigid[[0, 1, third]]
        mean, variance = reference.volume(label, before[three])
        if not np.isfinite(variance):
            continue
        there = (laid[:, three] >= 0).all(1)
        found = triple_products(now[None, :], now[laid[:, three]][:, None])
        cost = np.minimum(0.5 * (np.nan_to_num(found) - mean) ** 2 / variance, CAP)
        share = reference.weight[label, before[three]].min()
        added += np.where(there[:, None], VOLUME_WEIGHT * share * cost, 0.0)
    return added


def _spread(
    tracks: np.ndarray, alive: np.ndarray, found: np.ndarray, reference: ReferenceTake
) -> tuple[np.ndarray, float]:
    """Propagate the labels ``found`` to all chains of tracklets. Return each chain's label and the score of the fit."""
    seen = [np.flatnonzero(column) for column in alive.T]
    samples = [frames[np.unique(np.linspace(0, len(frames) - 1, SAMPLES).astype(int))] for frames in seen]
    for _ in range(ROUNDS):
        named = _named(tracks, found, len(reference.labels))
        cost = np.stack([_cost(tracks[s, c], named[s], found[c], reference) for c, s in enumerate(samples)])
        before, found = found, _chosen(cost, alive)
        if np.array_equal(before, found):
            break
    named = _named(tracks, found, len(reference.labels))
    there = np.flatnonzero(found >= 0)
    cost = [_cost(tracks[samples[c], c], named[samples[c]], found[c], reference)[found[c]] for c in there]
    return found, float(alive.sum(0)[there] @ (CAP - np.minimum(cost, CAP)))


def _named(tracks: np.ndarray, found: np.ndarray, count: int) -> np.ndarray:
    named = np.full((len(tracks), count, 3), np.nan)
    for c in np.flatnonzero(found >= 0):
        there = np.isfinite(tracks[:, c, 0])
        named[there, found[c]] = tracks[there, c]
    return named


def _cost(points: np.ndarray, named: np.ndarray, own: int, reference: ReferenceTake) -> np.ndarray:
    """Return the mean cost (L,) of each label for a tracklet, given its distances to labelled points.

    ``points`` (S, 3) are the tracklet's positions in S frames, and ``named`` (S, L, 3) are the labelled points in these
    frames. Distances to the label ``own``, which the tracklet has now (-1 if none), are ignored.
    """
    distance = np.linalg.norm(named - points[:, None], axis=-1)
    if own >= 0:
        distance[:, own] = np.nan
    there = np.isfinite(distance)[:, None] & np.isfinite(reference.distance)
    off = np.where(there, distance[:, None] - reference.distance, 0.0)
    weight = there * reference.weight
    each = np.minimum(0.5 * off**2 / np.where(np.isfinite(reference.variance), reference.variance, 1.0), CAP)
    total = weight.sum((0, 2))
    return np.where(total > 0.5, (weight * each).sum((0, 2)) / np.maximum(total, 1e-9), np.inf)


def _chosen(cost: np.ndarray, alive: np.ndarray) -> np.ndarray:
    found, used = np.full(len(cost), -1), np.zeros((alive.shape[0], cost.shape[1]), dtype=bool)
    two = np.sort(cost, axis=1)[:, :2]
    with np.errstate(invalid="ignore"):
        margin = two[:, 1] - two[:, 0]
    margin[np.isnan(margin)] = 0.0
    for c in np.argsort(-margin * np.sqrt(alive.sum(0)), kind="stable"):
        frames = alive[:, c]
        own = np.where(used[frames].any(0), np.inf, cost[c])
        best = int(np.argmin(own))
        rest = np.delete(own, best).min(initial=np.inf)
        if own[best] < FITS and rest - own[best] > CLEAR * min(1.0, own[best] + 0.5):
            found[c] = best
            used[frames, best] = True
    return found


TAKE_FRAMES, LEAST_FRAMES = 120, 8  # Frames used from a take, and smallest number for a marker.
SKIN_M = 0.01  # Standard deviation (m) of a rigid pair's distance between takes, due to placement and soft tissue.
CONFUSED_M = 0.35
"""Largest distance in metres between markers that people confuse. The farthest observed pair was on a forearm and an
upper arm."""
OTHERS = 3  # Number of other markers that determine a pair's side: those that are most rigid with both.
OPEN = -4.0  # Gain from distances below which sides are not compared.


@dataclass(frozen=True)
class TakeShape:
    """Positions of M markers in a take, and statistics of the distances between them."""

    points: np.ndarray  # (F, M, 3) positions in metres, NaN where missing.
    distance: np.ndarray  # (M, M) mean distances in metres, NaN if too few frames show both.
    variance: np.ndarray  # (M, M) variances in m² of the distances and of their changes between takes.


def shape_of(points: np.ndarray, skin_m: float = SKIN_M) -> TakeShape:
    """Measure the distances between markers (F, M, 3). Rarely visible markers are omitted."""
    some = points[np.unique(np.linspace(0, len(points) - 1, TAKE_FRAMES).astype(int))].copy()
    some[:, np.isfinite(some).all(-1).sum(0) < min(LEAST_FRAMES, len(some))] = np.nan
    mean, variance = distance_statistics(some)
    return TakeShape(some, mean, variance + skin_m**2 + (BEND * np.maximum(mean - NEAR_M, 0.0)) ** 2)


def exchange_gains(one: TakeShape, other: TakeShape, pairs: np.ndarray) -> np.ndarray:
    """Return how much better two takes of M markers agree (P,) if one of P marker pairs (P, 2) is swapped in one take.

    The gain is ``Σ_c w_c [q(a, a) + q(b, b) - q(a, b) - q(b, a)]`` with ``q(x, y) = min(½ (d_xc - d'_yc)² / v_c, cap)``
    for a pair (a, b) and all other markers c. d and d' are the distances between markers in the two takes, v their
    variance and w a weight for rigid pairs. The triple products add a gain of the same form (``_by_side``).
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
    """Return how much better (K,) two takes agree if a candidate point replaces a marker's labelled point.

    The first take has M markers, followed by additional points. ``candidates`` (K,) are indices of these additional
    points. The second take has the same M markers, and NaN for the additional points.
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
    """Return how much better the triple products of two takes agree if two markers are swapped in one take.

    Each triple product contains the two swapped markers and two of the most rigid other markers.
    """
    gain = 0.0
    around = [int(c) for c in np.argsort(-rigid, kind="stable")[:OTHERS] if rigid[c] > 0.1]
    for c, d in combinations(around, 2):
        (here, spread), (there, spread_there) = (_handedness(take.points, pair, c, d) for take in (one, other))
        variance = spread + spread_there + 2.0 * VOLUME**2
        straight, crossed = ((0.5 * (here - sign * there) ** 2 / variance) for sign in (1.0, -1.0))
        gain += min(rigid[c], rigid[d]) * (min(straight, CAP) - min(crossed, CAP))
    return gain


def _handedness(points: np.ndarray, pair: np.ndarray, c: int, d: int) -> tuple[float, float]:
    """Return the mean and variance over the take of the triple product ``u · (v × w)`` of unit vectors.

    u is the direction of the marker pair. v and w point from the pair's middle to the markers c and d.
    """
    first, second = points[:, pair[0]], points[:, pair[1]]
    middle = 0.5 * (first + second)
    u, v, w = (unit(part) for part in (second - first, points[:, c] - middle, points[:, d] - middle))
    found = np.einsum("fi,fi->f", u, np.cross(v, w))
    found = found[np.isfinite(found)]
    return (float(found.mean()), float(found.var())) if len(found) >= LEAST_FRAMES else (0.0, np.inf)


OF_TAKES = 2  # Largest number of other takes that count as independent observations of a swap.
EXCHANGE_ROUNDS = 12  # Largest number of swaps in one take. Takes are compared again after each.
MOST_TOGETHER, BESIDE = 12, 3
"""Largest number of takes compared in pairs, and number of these with which each further take is compared."""
_PLACED_M = 0.03  # Standard deviation in metres of the distance between two markers at known landmarks.


@dataclass(frozen=True)
class NameChange:
    """Two labels that are swapped in one take."""

    take: int  # Index of the take, from 0.
    first: str
    second: str  # Labels, or the former label of an unnamed point that takes the first one.
    mended: bool  # False if the takes do not show which name is correct. The names are then kept.


@dataclass(frozen=True)
class NamesOverTakes:
    """Takes of one person after their labels were made consistent."""

    clouds: tuple[MarkerCloud, ...]
    changes: tuple[NameChange, ...]


def names_over_takes(clouds: Sequence[MarkerCloud], kept: Collection[str] = ()) -> NamesOverTakes:
    """Make marker labels consistent across the takes of one person.

    Two takes contradict each other about a pair of labels if swapping the labels in one take makes the marker distances
    and the sides of both takes agree. A take is corrected if all other takes contradict it and agree with each other.
    If equally many takes support both versions, the landmarks on the average body decide. If they cannot decide either,
    the labels are kept and reported.

    The user's labels (``kept``) are not changed. Each column in the takes is one marker throughout.
    """
    takes, mended = list(clouds), list[NameChange]()
    if len(takes) < 2 or any(cloud.labels is None for cloud in takes):
        return NamesOverTakes(tuple(takes), ())
    if len(takes) > MOST_TOGETHER:
        return _of_many(takes, kept)
    for _ in range(EXCHANGE_ROUNDS):
        found = _changes(takes, kept)
        # Swap one pair at a time in each take, because a swapped pair makes its neighbours look swapped.
        first = {change.take: change for change in reversed(found) if change.mended and change not in mended}
        for change in first.values():
            takes[change.take] = with_exchanged(takes[change.take], change.first, change.second)
        mended += first.values()
        if not first:
            return NamesOverTakes(tuple(takes), (*mended, *(change for change in found if not change.mended)))
    return NamesOverTakes(tuple(takes), tuple(mended))


def _of_many(takes: list[MarkerCloud], kept: Collection[str]) -> NamesOverTakes:
    """Make a selection of the takes consistent with each other, then each remaining take with a few of these."""
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
    """Find swaps that make takes consistent, most certain first. Each label of a take is in one swap at most."""
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
    """Find the takes with two swapped labels. Return each take, the gain in nats, and whether the swap is certain.

    ``gain`` (T, T) is the gain from a swap between two takes, NaN if one of them does not show both markers.
    ``by_layout`` (T,) is the gain relative to the layout's landmarks. It decides between equally many takes.

    The other takes are compared with the same take, whose error they share, so at most ``OF_TAKES`` of them count as
    independent. A swap is certain if it gains more than ``BOUND``. In 24 correct sets of four takes (UI-PRMD), none
    gains half of it, but some gain 22 relative to a single take.
    """
    there = np.flatnonzero(np.isfinite(gain).any(1))
    between = gain[np.ix_(there, there)]
    likely = between > 0.5 * BOUND
    if not likely.any():
        return []
    odd = ~(between[int(np.argmax(likely.sum(axis=1)))] > 0.0)
    few, many = (odd, ~odd) if odd.sum() <= (~odd).sum() else (~odd, odd)
    across = between[np.ix_(few, many)]
    known = np.isfinite(across)
    clear = float(across[known].min(initial=np.inf)) * min(int(known.any(axis=0).sum()), OF_TAKES)
    if clear <= 0.5 * BOUND or any((between[np.ix_(group, group)] > 0.0).any() for group in (few, many)):
        return []
    if few.sum() < many.sum():
        return [(int(take), clear, clear > BOUND) for take in there[few]]
    one, other = (float(np.mean(by_layout[there[group]])) for group in (few, many))
    return [(int(take), clear, min(clear, abs(one - other)) > BOUND) for take in there[few if one > other else many]]


def _replacements(
    takes: Sequence[MarkerCloud],
    labels: list[str],
    shapes: Sequence[TakeShape],
    places: TakeShape,
    kept: Collection[str],
) -> list[tuple[float, NameChange]]:
    """Find markers whose label is on the wrong point in a take. Return the gain and the change to the right point."""
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
            fits = bool(least.size) and float(least.max()) * min(len(rest), OF_TAKES) > BOUND
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
    """Place the labels' landmarks on the average body. Labels without a landmark in the layouts are NaN."""
    body, known = load_body(), name_markers(labels).known
    named = [i for i, label in enumerate(labels) if known.get(label, "@")[0] != "@"]
    points = np.full((LEAST_FRAMES, len(labels), 3), np.nan)
    if named:
        points[:, named] = marker_landmarks(body, tuple(known[labels[i]] for i in named)).anchors.sum(axis=1)
    return shape_of(points, _PLACED_M)


def with_exchanged(cloud: MarkerCloud, first: str, second: str) -> MarkerCloud:
    """Swap two labels of a take."""
    swapped = {first: second, second: first}
    return replace(cloud, labels=tuple(swapped.get(label, label) for label in cloud.names))
