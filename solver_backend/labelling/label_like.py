"""Names for the points of a take from one labelled take of the same person and layout.

Pairs of markers on one bone keep their distance, others stay near theirs. At the moment that shows most points, a beam
search places the labels, those first that are most rigid with what is placed. Triple products exclude mirror images.
From there names spread over time: a tracklet gets the only label that fits its distances to the named points.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.exchange.errors import NoDetections
from solver_backend.geometry.small_matrices import unit
from solver_backend.labelling.tracklets import Tracklets, tracklets_of
from solver_backend.types import MarkerCloud

FRAMES, LEAST_COMMON = 240, 5
"""Most frames of the take to use, and least frames that show both markers of a known pair."""
FLOOR_M, NEAR_M, BEND = 0.008, 0.12, 0.15
"""Standard deviation of a rigid pair's distance by sliding skin, and the share that adds to it per distance beyond
``NEAR_M``: another take bends joints that are still in this one."""
RIGID_M = 0.02  # Deviation of a pair that weighs half.
VOLUME = 0.12  # Additional standard deviation of a triple product of unit vectors between takes.


@dataclass(frozen=True)
class ReferenceTake:
    """Distances and orientations of L markers."""

    labels: tuple[str, ...]
    distance: np.ndarray  # (L, L) metres, the means, NaN where a pair is never seen.
    variance: np.ndarray  # (L, L) m².
    weight: np.ndarray  # (L, L) weight of each pair, 0 to 1, with 0 on the diagonal.
    points: np.ndarray  # (F, L, 3) metres.

    def volume(self, label: int, others: np.ndarray) -> tuple[float, float]:
        """Return mean and variance of the triple product of unit vectors from a marker to three others."""
        found = triple_products(self.points[:, label], self.points[:, others])
        found = found[np.isfinite(found)]
        return (float(found.mean()), float(found.var()) + VOLUME**2) if found.size else (0.0, np.inf)


def reference_of(cloud: MarkerCloud) -> ReferenceTake:
    """Return the distances and orientations in a labelled take."""
    some = np.unique(np.linspace(0, len(cloud.positions) - 1, FRAMES).astype(int))
    points = cloud.positions[some]
    mean, variance = distance_statistics(points)
    spread = variance + FLOOR_M**2 + (BEND * np.maximum(mean - NEAR_M, 0.0)) ** 2
    weight = np.nan_to_num(1.0 / (1.0 + spread / RIGID_M**2))
    np.fill_diagonal(weight, 0.0)
    return ReferenceTake(cloud.names, mean, spread, weight, points)


def distance_statistics(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (N, N) means and variances of the distances of (F, N, 3) points, NaN where too few frames show both."""
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
    """Return (...) the triple product of the unit vectors from (..., 3) points to (..., 3, 3) others."""
    along = unit(others - points[..., None, :])
    return np.einsum("...i,...i->...", along[..., 0, :], np.cross(along[..., 1, :], along[..., 2, :]))


BEAM, FIRST_BEAM, SEED = 150, 3000, 5  # Hypotheses to keep, and while fewer labels than ``SEED`` are placed.
CAP, SKIP = 6.0, 2.0
"""Largest cost of one pair in halves of squared deviations, as of a bent joint or a wrong pair, and the cost of a pair
with a label on no point. A right one costs 0.5."""
VOLUMES, VOLUME_WEIGHT = 3, 3.0  # Triple products of each new label, and the weight of each against a rigid pair.
FITS, CLEAR = 4.0, 0.2
"""Largest mean cost of a tracklet that fits a label, and the least difference to the cost of the next label."""
SAMPLES, ROUNDS = 24, 6  # Frames of a tracklet to use, and rounds in which names spread.


@dataclass(frozen=True)
class LikeTake:
    """A take named after another."""

    tracklets: Tracklets
    chain_label: np.ndarray  # (C,) label of each chain of tracklets, -1 where none is sure.
    labels: tuple[str, ...]  # Of the reference.

    @property
    def point_labels(self) -> np.ndarray:
        """(F, N) label of each point, -1 where none."""
        number = self.tracklets.number
        return np.where(number >= 0, self.chain_label[self.tracklets.chain][number], -1)

    def cloud(self, source: MarkerCloud) -> MarkerCloud:
        """Return the points by label, and those without a name after them."""
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
    """Name a take's points after a labelled take of the same person.

    The names of the cloud are ignored. ``persistent``: each column is one marker throughout. ``proposed`` (F, N) are
    the network's labels, -1 where none, as another start. The better fit wins.

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
        raise NoDetections("No frame shows enough points to name them.", hint="Choose another recording.")
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
    """Return the label of each of (N, 3) points ``now``, -1 where none is, from (F, N, 3) points around that moment."""
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
    """Return (B, N) costs of triple products with the labels laid before."""
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
    """Return the label of every chain, starting from known ones, and the score of the fit."""
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
    """Return (L,) the mean cost over pairs of each label for a tracklet, by its distances to the named points.

    Points (S, 3) are of the tracklet, ``named`` (S, L, 3). Its own label (-1 if none) is not a named point.
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
        margin = np.nan_to_num(two[:, 1] - two[:, 0], nan=0.0)
    for c in np.argsort(-margin * np.sqrt(alive.sum(0)), kind="stable"):
        frames = alive[:, c]
        own = np.where(used[frames].any(0), np.inf, cost[c])
        best = int(np.argmin(own))
        rest = np.delete(own, best).min(initial=np.inf)
        if own[best] < FITS and rest - own[best] > CLEAR * min(1.0, own[best] + 0.5):
            found[c] = best
            used[frames, best] = True
    return found
