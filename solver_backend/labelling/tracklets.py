"""Form tracklets from points, assign each label once per frame, and compare distances with a table."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from pathlib import Path

import numpy as np

from solver_backend.exchange.errors import WeightsInvalid
from solver_backend.geometry.arrays import true_runs
from solver_backend.labelling.outputs import GHOST, MARKERS, OTHER_PLACES, other_side
from solver_backend.priors.weights import ASSETS, read_weights

SPLIT_GAP_S = 0.1  # A point that is missing for longer (seconds) may come back as another marker.
JUMP_M, JUMP_M_S2 = 0.03, 300.0
"""Largest change between steps in metres, and largest acceleration. No marker on a person exceeds them."""
JOIN_S, JOIN_M = 0.1, 0.02
"""Longest gap (s) between a tracklet and its continuation, and largest distance (m) from the extrapolated position."""
CLEAR = 0.5  # Largest ratio between the distances of the chosen and the next best continuation.


@dataclass(frozen=True)
class Tracklets:
    """T tracks of single points, split at gaps and jumps. A chain consists of consecutive tracklets of one marker.

    ``column``, ``first`` frame, ``last`` frame and ``chain`` are (T,) arrays.
    """

    number: np.ndarray  # (F, N) index of each point's tracklet, -1 where there is no point.
    column: np.ndarray
    first: np.ndarray
    last: np.ndarray
    chain: np.ndarray

    def __len__(self) -> int:
        return len(self.column)

    @property
    def num_chains(self) -> int:
        """Number of chains of tracklets."""
        return int(self.chain.max(initial=-1)) + 1


def tracklets_of(positions: np.ndarray, fps: float, *, persistent: bool = False) -> Tracklets:
    """Form tracklets from (F, N, 3) points in metres, NaN where missing.

    ``persistent``: each column is one marker throughout, with a given name, and its tracklets form one chain.
    """
    seen = np.isfinite(positions).all(-1)
    number = np.full(seen.shape, -1)
    rows: list[tuple[int, int, int]] = []
    for column in np.flatnonzero(seen.any(0)):
        for first, last in _stretches(positions[:, column], seen[:, column], fps):
            number[first : last + 1, column] = np.where(seen[first : last + 1, column], len(rows), -1)
            rows.append((int(column), first, last))
    column, first, last = np.array(rows, dtype=int).reshape(-1, 3).T
    chain = column if persistent else _chains(positions, column, first, last, fps)
    return Tracklets(number, column, first, last, np.unique(chain, return_inverse=True)[1])


def _stretches(points: np.ndarray, seen: np.ndarray, fps: float) -> list[tuple[int, int]]:
    found: list[tuple[int, int]] = []
    for first, last in true_runs(seen):
        run = points[first : last + 1]
        steps = np.diff(run, axis=0)
        sudden = np.linalg.norm(np.diff(steps, axis=0, prepend=steps[:1]), axis=-1) > JUMP_M + JUMP_M_S2 / fps**2
        # A jump has two sudden steps, away and back. The track is cut at the first one.
        cuts = np.flatnonzero(sudden & ~np.roll(sudden, 1)) if sudden.any() else []
        edges = [first, *(first + int(c) + 1 for c in cuts), last + 1]
        found += [(a, b - 1) for a, b in pairwise(edges) if b > a]
    joined: list[tuple[int, int]] = []
    for first, last in found:
        # A point that soon returns at its expected position is the same point.
        if joined and 1 < first - joined[-1][1] <= SPLIT_GAP_S * fps and _off(points, joined[-1], first) < JUMP_M:
            joined[-1] = (joined[-1][0], last)
        else:
            joined.append((first, last))
    return joined


def _off(points: np.ndarray, run: tuple[int, int], frame: int) -> float:
    a, b = run
    velocity = points[b] - points[b - 1] if b > a and np.isfinite(points[b - 1]).all() else np.zeros(3)
    return float(np.linalg.norm(points[frame] - points[b] - (frame - b) * velocity))


def _chains(positions: np.ndarray, column: np.ndarray, first: np.ndarray, last: np.ndarray, fps: float) -> np.ndarray:
    """Return each tracklet's chain. A tracklet continues a chain that ends nearby, if no other one starts as near."""
    count = len(column)
    chain = np.arange(count)
    if count < 2:
        return chain
    start, end = positions[first, column], positions[last, column]
    before = np.maximum(last - 1, first)
    velocity = np.nan_to_num(end - positions[before, column])
    soon = max(1, round(JOIN_S * fps))
    by_first = np.argsort(first, kind="stable")
    begins = first[by_first]
    follower, cost = np.full(count, -1), np.full(count, np.inf)
    for t in range(count):
        low, high = np.searchsorted(begins, (last[t] + 1, last[t] + soon + 1))
        rivals = by_first[low:high]
        if not len(rivals):
            continue
        ahead = (first[rivals] - last[t])[:, None]
        distance = np.linalg.norm(start[rivals] - end[t] - ahead * velocity[t], axis=-1)
        distance = np.minimum(distance, np.linalg.norm(start[rivals] - end[t], axis=-1))
        best, *others = np.argsort(distance)
        if distance[best] < JOIN_M and (not others or distance[best] < CLEAR * distance[others[0]]):
            follower[t], cost[t] = rivals[best], distance[best]
    for t in np.argsort(cost):
        if follower[t] < 0:
            break
        if (follower == follower[t]).sum() == 1 or cost[t] == cost[follower == follower[t]].min():
            follower[(follower == follower[t]) & (np.arange(count) != t)] = -1
    for t in np.argsort(first, kind="stable"):
        if follower[t] >= 0:
            chain[follower[t]] = chain[t]
    return chain


_TAKEN = -1e9  # Evidence for a label that is already used, below any log probability.
_ROUNDS, _EXCHANGES, _GAIN = 4, 200, 1e-6
"""Largest numbers of rounds and of swaps per round, and smallest gain of a swap, chosen by hand."""


def labels_of_frame(log_probability: np.ndarray) -> np.ndarray:
    """Label the points of a frame from (N, 54) log probabilities (ghost last). Each marker is assigned at most once."""
    scores = np.array(log_probability)
    labels = np.full(len(scores), GHOST)
    rows = np.arange(len(scores))
    for _ in range(GHOST):
        if not len(rows):
            break
        best = scores[rows].argmax(1)
        value = scores[rows, best]
        # If several points claim a marker, the most certain one (compared with being no marker) gets it.
        surplus = value - scores[rows, GHOST]
        order = np.lexsort((-surplus, best))
        winners = order[np.unique(best[order], return_index=True)[1]]
        done = (best == GHOST) | np.isin(np.arange(len(rows)), winners)
        labels[rows[done]] = best[done]
        taken = np.unique(best[best != GHOST])
        scores[:, taken] = _TAKEN
        rows = rows[~done]
    return labels


def labels_of_stretches(evidence: np.ndarray, together: np.ndarray, bound: dict[int, int] | None = None) -> np.ndarray:
    """Assign the labels (T,) with most evidence to tracklets. Simultaneous tracklets never share a marker.

    The tracklet with the largest margin between its best and its second-best free label chooses first. Pairs then swap
    their labels as long as the total evidence grows. ``evidence`` (T, 54) are log likelihoods, ghost last. ``together``
    (T, T) marks pairs that are visible at the same time, and ``bound`` contains the user's labels by tracklet.
    """
    count = len(evidence)
    labels = np.full(count, -1)
    free = np.ones((count, GHOST + 1), dtype=bool)
    for t, label in (bound or {}).items():
        labels[t] = label
        if label != GHOST:
            free[together[t], label] = False
    fixed = labels >= 0
    open_ = ~fixed
    margin = _margins(free, evidence)
    while open_.any():
        rows = np.flatnonzero(open_)
        t = rows[np.argmax(margin[rows])]
        labels[t] = int(np.argmax(np.where(free[t], evidence[t], _TAKEN)))
        open_[t] = False
        if labels[t] != GHOST:
            loses = together[t] & free[:, labels[t]]
            free[loses, labels[t]] = False
            margin[loses] = _margins(free[loses], evidence[loses])
    for _ in range(_ROUNDS):
        if not _exchanged(labels, evidence, together, fixed):
            break
    return labels


def _margins(free: np.ndarray, evidence: np.ndarray) -> np.ndarray:
    two = np.partition(np.where(free, evidence, _TAKEN), -2, axis=1)[:, -2:]
    return two[:, 1] - two[:, 0]


def _exchanged(labels: np.ndarray, evidence: np.ndarray, together: np.ndarray, fixed: np.ndarray) -> bool:
    """Swap the labels of tracklet pairs if that increases their evidence. Return whether any were swapped."""
    own = evidence[np.arange(len(labels)), labels]
    other = evidence[:, labels]
    gain = other + other.T - own[:, None] - own[None]
    gain[~together | fixed[:, None] | fixed[None]] = 0.0
    changed = False
    better = np.flatnonzero(gain > _GAIN)
    for flat in better[np.argsort(-gain.ravel()[better])[:_EXCHANGES]]:
        a, b = np.unravel_index(flat, gain.shape)
        if gain[a, b] <= _GAIN:
            break
        if _may(labels, together, a, labels[b], b) and _may(labels, together, b, labels[a], a):
            labels[a], labels[b] = labels[b], labels[a]
            gain[[a, b]] = gain[:, [a, b]] = 0.0
            changed = True
    return changed


def _may(labels: np.ndarray, together: np.ndarray, t: np.intp, label: int, but: np.intp) -> bool:
    if label == GHOST:
        return True
    rivals = together[t] & (labels == label)
    rivals[[t, but]] = False
    return not rivals.any()


NAME = "marker_distances"
FLOOR_M, PLACED_M = 0.004, 0.006
"""Noise floor of a distance change before its logarithm, and standard deviation due to skin and glue, in metres."""
FREEDOM = 4.0  # Degrees of freedom of Student's t-distribution, so that one wrongly labelled partner cannot decide.
LONG_S = 3.0  # Seconds of common visibility after which the change of a distance is fully informative.
ALIKE, ALIKE_M, ALIKE_CHANGE = 0.5, 0.012, 0.5
"""Fraction of pairs with similar positions on both sides of a person, and the difference between their distances in
metres and relative to their change."""
READINGS, _SHARE, FEWEST_PARTNERS = 8.0, 0.35, 6
"""Largest number of independent partners (one marker's position affects all of its distances), largest weight of one
partner, and smallest number of partners of a labelled tracklet. Chosen by hand."""
_BLOCK, _PAIRS, _CELLS = 256, 256 * 60**2, 2**22
"""Frames, point pairs, and chains times landmarks times partners per step. They limit memory to 32 MB per intermediate
array and were chosen by hand. With a thousand points, frames are compared one by one."""
_SCALE_FROM_M = 0.3  # Smallest distance in metres between pairs that determine the body size, chosen by hand.
_COUNTERPART = np.array([MARKERS.index(other_side(name)) for name in MARKERS])
_SIDE = np.array([{"L": 1, "R": -1}.get(name[0], 0) * (other_side(name) != name) for name in MARKERS])


@dataclass(frozen=True)
class DistanceTable:
    """Normal distributions of the distances between P landmarks, over short time windows."""

    mean: np.ndarray  # (P, P) mean distances in metres for a person of average size.
    spread: np.ndarray  # (P, P) standard deviations in metres across people, placements and windows.
    change: np.ndarray  # (P, P) mean logarithm of the standard deviation over a window plus ``FLOOR_M``.
    change_spread: np.ndarray  # (P, P) standard deviation of that logarithm.


@dataclass(frozen=True)
class ChainDistances:
    """Distances (C, C) between chains: mean (m), change (see ``DistanceTable``) and seconds of common visibility."""

    mean: np.ndarray
    change: np.ndarray
    seconds: np.ndarray


@lru_cache(maxsize=1)
def load_distances(path: Path | None = None) -> DistanceTable:
    """Load the distance table from a file, or the built-in one. Raise FileMissing or WeightsInvalid."""
    arrays = read_weights(path or ASSETS / f"{NAME}.npz", NAME).arrays
    places = len(MARKERS) + len(OTHER_PLACES)
    pairs = places * (places - 1) // 2
    if any(arrays[name].shape != (pairs,) for name in ("mean", "spread", "change", "change_spread")):
        raise WeightsInvalid("The table of distances is for other marker positions.")
    own = {"mean": 0.0, "spread": PLACED_M, "change": np.log(FLOOR_M), "change_spread": 1.0}
    return DistanceTable(*(_square(arrays[name].astype(np.float64), places, value) for name, value in own.items()))


def _square(pairs: np.ndarray, size: int, own: float) -> np.ndarray:
    full = np.zeros((size, size))
    full[np.triu_indices(size, 1)] = pairs
    return full + full.T + own * np.eye(size)


def distances_of(positions: np.ndarray, frames: np.ndarray, tracklets: Tracklets, fps: float) -> ChainDistances:
    """Measure the distances between chains over the given frames of (F, N, 3) positions."""
    chains = tracklets.num_chains
    between = float(np.median(np.diff(frames))) / fps if len(frames) > 1 else 1.0
    sums = np.zeros((3, chains * chains))
    size = int(np.clip(_PAIRS // max(positions.shape[1] ** 2, 1), 1, _BLOCK))
    for start in range(0, len(frames), size):
        part = frames[start : start + size]
        number = tracklets.number[part]
        # Put the columns for each part of the frames first, because only a few of many short tracks exist at any time.
        shown = np.argsort(number < 0, axis=1, kind="stable")[:, : int((number >= 0).sum(1).max(initial=0))]
        points, number = positions[part[:, None], shown], np.take_along_axis(number, shown, axis=1)
        chain = np.where(number >= 0, tracklets.chain[number], -1)
        both = (chain[:, :, None] >= 0) & (chain[:, None] >= 0)
        apart = np.linalg.norm(points[:, :, None] - points[:, None], axis=-1)[both]
        pair = (chain[:, :, None] * chains + chain[:, None])[both]
        cells: slice | np.ndarray = slice(None)
        count = chains * chains
        if len(pair) < count:
            cells, pair = np.unique(pair, return_inverse=True)
            count = len(cells)
        for row, value in zip(sums, (np.ones_like(apart), apart, apart * apart), strict=True):
            row[cells] += np.bincount(pair, value, count)
    count, total, square = sums.reshape(3, chains, chains)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = total / count
        change = np.sqrt(np.maximum(square / count - mean * mean, 0.0))
    return ChainDistances(mean, change, count * between)


def distance_evidence(
    found: ChainDistances, labels: np.ndarray, trusted: np.ndarray, table: DistanceTable
) -> np.ndarray:
    """Return log likelihoods (C, 54) of each chain's labels, given its distances to the trusted chains.

    The log likelihood of label a for chain i is ``sum_j log t(m_ij / s | mu_ab, sigma_ab) + log t(c_ij | ...)`` over
    trusted chains j with labels b. m is the mean distance, c its change, s the person's relative size, and t Student's
    t-distribution. The sum counts at most as much as ``READINGS`` chains. If the two corresponding markers on the other
    side of the body are labelled, the first density is mixed in equal parts with a density around their distance in
    this take. The label ghost stands for a landmark of another layout, or for any other position on the body.
    """
    chains = len(labels)
    partners = np.flatnonzero(trusted & (labels >= 0) & (labels < GHOST))
    if len(partners) < FEWEST_PARTNERS:
        return np.zeros((chains, GHOST + 1))
    theirs = labels[partners]
    size = _size(found.mean[np.ix_(partners, partners)], table.mean[np.ix_(theirs, theirs)])
    mirrored = _of_the_other_side(found, partners, theirs)[:, theirs] / size
    rows = max(1, _CELLS // (len(table.mean) * len(partners)))
    if rows >= chains:
        return _evidence_of(np.arange(chains), found, labels, partners, mirrored, size, table)
    evidence, beside = np.empty((chains, GHOST + 1)), np.isfinite(found.mean[:, partners])
    # Consecutive tracklets have the same first partner. Most short tracklets are never visible with a part's partners.
    order = np.argsort(beside.argmax(axis=1), kind="stable")
    for start in range(0, chains, rows):
        which = order[start : start + rows]
        near = beside[which].any(axis=0)
        near[0] |= not near.any()
        evidence[which] = _evidence_of(which, found, labels, partners[near], mirrored[:, near], size, table)
    return evidence


def _evidence_of(
    which: np.ndarray,
    found: ChainDistances,
    labels: np.ndarray,
    partners: np.ndarray,
    mirrored: np.ndarray,
    size: float,
    table: DistanceTable,
) -> np.ndarray:
    """Return the rows of ``distance_evidence`` for the chains ``which`` (R,), from distances to ``partners``.

    ``mirrored`` is the result of ``_of_the_other_side``, divided by ``size``. ``size`` is the ratio of the person's
    size to the size in the table.
    """
    theirs, pairs = labels[partners], np.ix_(which, partners)
    mean, change = found.mean[pairs] / size, found.change[pairs] / size
    weight = np.isfinite(mean) & (partners[None] != which[:, None])
    long = np.minimum(found.seconds[pairs] / LONG_S, 1.0)
    # A short observation may show any phase of the pair's movement.
    moment = np.exp(2.0 * table.change[:, theirs])[None] * (1.0 - long[..., None].swapaxes(1, 2))
    variance = table.spread[:, theirs][None] ** 2 + PLACED_M**2 + moment  # (R, P, partners)
    measured = np.nan_to_num(mean)[:, None]
    log = _student(measured - table.mean[:, theirs][None], variance)
    near = ALIKE_M**2 + (ALIKE_CHANGE * np.exp(table.change[:GHOST, theirs])) ** 2 + moment[:, :GHOST]
    alike = _student(measured - np.nan_to_num(mirrored)[None], np.minimum(variance[:, :GHOST], near))
    mixed = np.logaddexp(np.log(1.0 - ALIKE) + log[:, :GHOST], np.log(ALIKE) + alike)
    log[:, :GHOST] = np.where(np.isfinite(mirrored)[None], mixed, log[:, :GHOST])
    off = np.log(change + FLOOR_M)[:, None] - table.change[:, theirs][None]
    log += (long * (long >= 0.3))[:, None] * _student(np.nan_to_num(off), table.change_spread[:, theirs][None] ** 2)
    # A chain that takes a partner's label gives its own in return, so their distance is between the same two markers.
    rows, them = np.arange(len(which))[:, None], np.arange(len(partners))[None]
    named = ((labels[which] >= 0) & (labels[which] < GHOST))[:, None]
    own = np.where(named[:, 0], labels[which], 0)[:, None]
    log[rows, theirs[None], them] = np.where(named, log[rows, own, them], _log_mean_exp(log))
    log = np.where(weight[:, None], log, 0.0)
    tempered = np.minimum(_SHARE, READINGS / np.maximum(weight.sum(1), 1.0))[:, None]
    by_place = tempered * log.sum(-1)
    anywhere = tempered[:, 0] * _log_mean_exp(log).sum(-1)
    none = np.logaddexp(anywhere, _log_mean_exp(by_place[:, GHOST:]))
    return np.concatenate([by_place[:, :GHOST], none[:, None]], axis=1)


def _of_the_other_side(found: ChainDistances, partners: np.ndarray, theirs: np.ndarray) -> np.ndarray:
    """For each pair of markers, return the distance (53, 53) between their counterparts on the other side of the body.

    The distance is NaN if the two markers are on different sides. Otherwise, a chain with a label of the wrong side
    would be its own counterpart.
    """
    pairs = np.ix_(partners, partners)
    mean, seconds = found.mean[pairs], found.seconds[pairs]
    is_label = np.eye(GHOST)[theirs]
    with np.errstate(invalid="ignore", divide="ignore"):
        measured = is_label.T @ (np.nan_to_num(mean) * seconds) @ is_label / (is_label.T @ seconds @ is_label)
    return np.where(_SIDE[:, None] * _SIDE == 1, measured[np.ix_(_COUNTERPART, _COUNTERPART)], np.nan)


def _size(found: np.ndarray, expected: np.ndarray) -> float:
    far = np.isfinite(found) & (expected > _SCALE_FROM_M)
    return float(np.clip(np.median(found[far] / expected[far]), 0.7, 1.4)) if far.any() else 1.0


def _student(error: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """Return log densities of Student's t-distribution for errors with a variance, up to a constant."""
    return -0.5 * (FREEDOM + 1.0) * np.log1p(error * error / (FREEDOM * variance)) - 0.5 * np.log(variance)


def _log_mean_exp(x: np.ndarray) -> np.ndarray:
    most = x.max(1, keepdims=True)
    return np.log(np.exp(x - most).mean(1)) + np.squeeze(most, 1)
