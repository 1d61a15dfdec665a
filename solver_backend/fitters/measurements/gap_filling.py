"""Fill gaps of markers with the body's marker and with the marker's own place among its neighbours."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.body.landmarks import Landmarks
from solver_backend.geometry.alignment import umeyama
from solver_backend.geometry.arrays import true_runs
from solver_backend.geometry.small_matrices import solved_3x3

NEIGHBOURS, FEWEST = 6, 3  # Markers that predict a gap, seen throughout: the steadiest ones, and the fewest.
FRAMES = 60  # Frames in which distances are measured, chosen by hand.
ROWS, PER_GAP, LEAST_ROWS = 600, 25, 20  # Frames to learn a gap from, most of them within a gap's length, and least.
NOISE_M = 0.00055  # Deviation of a neighbour's place that tells nothing: strength of the ridge.
SETTLES_S = 0.3  # Correlation time of what neighbours do not tell.
TRIALS, LEAST_TRIALS = 20, 2  # Gaps tried on seen frames to compare both fillings, and the least that decide.
HIDDEN = 3.0  # Error of the body's hidden marker by a seen one's, which draws the body to itself.
SHORTEST_S = 0.05  # Shorter gaps follow the body alone.


def steadiest_first(points: np.ndarray) -> np.ndarray:
    """Return for each of (F, M, 3) points the (M, M - 1) other points, the steadiest distance first."""
    some = points[np.unique(np.linspace(0, len(points) - 1, FRAMES).astype(int))]
    spread = np.linalg.norm(some[:, :, None] - some[:, None], axis=-1).std(axis=0)
    np.fill_diagonal(spread, np.inf)
    return np.argsort(spread, axis=1, kind="stable")[:, :-1]


@dataclass(frozen=True)
class Relation:
    """A marker's place among its neighbours in R frames around a gap: ``u = W v``, by ridge regression.

    Both are in the frame that turns and moves with the neighbours (Kabsch 1976): u is the marker's place, and v are the
    neighbours' places with a constant. So v is what a rigid cluster lacks: how the neighbours move within it.

    Reference: Hoerl and Kennard 1970, "Ridge regression", eq. 2.1.
    """

    rows: np.ndarray  # (R,) frames.
    turns: np.ndarray  # (R, 3, 3)
    middles: np.ndarray  # (R, 3)
    terms: np.ndarray  # (R, 1 + 3 K)
    places: np.ndarray  # (R, 3) metres, only used if known.
    known: np.ndarray  # (R,) the marker was measured.
    settles: float  # Correlation time of the error, frames.

    @classmethod
    def around(
        cls, points: np.ndarray, seen: np.ndarray, near: np.ndarray, gap: np.ndarray, settles: float
    ) -> Relation:
        """Return the relation about a gap from the marker's (F, 3) places and its neighbours' (F, K, 3)."""
        step = max(1, len(gap) // PER_GAP)
        rows = np.arange(gap[0] - 1 - ROWS // 2 * step, gap[-1] + 2 + ROWS // 2 * step, step)
        rows = np.unique(np.concatenate([rows, np.arange(gap[0] - 1, gap[-1] + 2)]))
        rows = rows[(rows >= 0) & (rows < len(points))]
        cluster, known = near[rows], seen[rows]
        _, turns, _ = umeyama(np.broadcast_to(near[gap[0]], cluster.shape), cluster)
        middles = cluster.mean(axis=1)
        within = ((cluster - middles[:, None]) @ turns).reshape(len(rows), -1)
        places = ((points[rows] - middles)[:, None] @ turns)[:, 0]
        within = within - within[known].mean(axis=0) if known.any() else within
        terms = np.concatenate([np.ones((len(rows), 1)), within], axis=1)
        return cls(rows, turns, middles, terms, places, known, settles)

    def weights(self, without: np.ndarray) -> np.ndarray:
        """Return (1 + 3 K, 3) the weights learned from all known rows but some."""
        kept = self.known.copy()
        kept[without] = False
        A = self.terms[kept]
        ridge = np.full(A.shape[1], len(A) * NOISE_M**2)
        ridge[0] = 1e-9  # the constant is free
        return np.linalg.solve(A.T @ A + np.diag(ridge), A.T @ self.places[kept])

    def predicted(self, inside: np.ndarray, ends: np.ndarray) -> np.ndarray:
        """Return the marker's (n, 3) place in the world in some rows, learned from the others and tied to its ends."""
        W = self.weights(inside)
        missed = self.places[ends] - self.terms[ends] @ W
        joined = between_ends(self.rows[inside], self.rows[ends], missed, self.settles)
        local = self.terms[inside] @ W + joined
        return self.middles[inside] + (self.turns[inside] @ local[..., None])[..., 0]

    def trials(self, length: int) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return the known rows inside gaps of a length of frames, and the rows of their ends."""
        found = []
        for start in np.unique(np.linspace(0, len(self.rows) - 1, TRIALS + 2).astype(int))[:-1]:
            stop = int(np.searchsorted(self.rows, self.rows[start] + length + 1))
            if stop < len(self.rows) and self.known[start] and self.known[stop]:
                inside = np.flatnonzero(self.known[start + 1 : stop]) + start + 1
                if 2 * len(inside) >= stop - start - 1 > 0:
                    found.append((inside, np.array([start, stop])))
        return found


def joining_shares(times: np.ndarray, length: int, lasting: float) -> np.ndarray:
    """Return ``sinh((n + 1 - t) / τ) / sinh((n + 1) / τ)``, the share of a gap's first end at times t, in frames."""
    away, span = times / lasting, (length + 1) / lasting
    return np.exp(-away) * np.expm1(-2 * (span - away)) / np.expm1(-2 * span)  # no long gap overflows


def between_ends(frames: np.ndarray, ends: np.ndarray, errors: np.ndarray, lasting: float) -> np.ndarray:
    """Return (n, 3): the mean of a process with these (E, 3) errors at both ends, at one, or at none."""
    since = np.abs(frames - ends[:, None])
    share = joining_shares(since, ends[1] - ends[0] - 1, lasting) if len(ends) == 2 else np.exp(-since / lasting)
    return share.T @ errors


LAG_S, LONGER = 0.2, 3.0
"""Lag of the errors' correlation, and factor in gaps: seen markers lose slow errors to the body."""
CORRELATION = (0.01, 0.98)  # Limits of that correlation.


def filled(measured: np.ndarray, solved: np.ndarray, bones: np.ndarray, fps: float) -> np.ndarray:
    """Return (F, M, 3) markers: as measured, and in gaps the mean of two predictions.

    The first is the body's marker, corrected to meet both ends:
    ``x(t) = y(t) + B(t) [ sinh((b - t) / τ) d_a + sinh((t - a) / τ) d_b ] / sinh((b - a) / τ)`` in a gap from a to b,
    with the body's marker y and its error at the ends in its bones' frame B, ``d = B⁻¹ (x - y)``: the mean of an
    Ornstein-Uhlenbeck process between its ends, ``d_a e^{-(t - a) / τ}`` in a gap with one end. τ follows from the
    take: errors last in slow movement and change within a stride.
    The second is the marker's place among its neighbours (``Relation``). Gaps of the same length where the marker is
    seen tell the mean squared errors ``e²`` of both, and the second has the weight ``e_1² / (e_1² + e_2²)``.
    ``bones`` are (F, M, 3, 3) mixed rotations of each marker's bones.

    Reference: Uhlenbeck and Ornstein 1930, "On the theory of the Brownian motion".
    """
    body, seen = measured.copy(), np.isfinite(measured).all(-1)
    off = solved_3x3(bones, measured - solved)
    lasting = LONGER * lasting_frames(off, max(1, round(LAG_S * fps)))
    gaps = [(m, np.arange(a, b + 1)) for m in np.flatnonzero(~seen.all(axis=0)) for a, b in true_runs(~seen[:, m])]
    for m, gap in gaps:
        ends = np.array([end for end in (gap[0] - 1, gap[-1] + 1) if 0 <= end < len(measured)], dtype=int)
        joined = between_ends(gap, ends, off[ends, m], lasting)
        body[gap, m] = solved[gap, m] + (bones[gap, m] @ joined[..., None])[..., 0]
    found, order = body.copy(), steadiest_first(body) if gaps else np.empty((0, 0), dtype=int)
    for m, gap in gaps:
        throughout = seen[max(gap[0] - 1, 0) : gap[-1] + 2].all(axis=0)
        near = order[m][throughout[order[m]]][:NEIGHBOURS]
        if len(near) >= FEWEST and len(gap) >= SHORTEST_S * fps:
            relation = Relation.around(body[:, m], seen[:, m], body[:, near], gap, SETTLES_S * fps)
            share = _share_of(relation, len(gap), measured[:, m], off[:, m], bones[:, m], lasting)
            if share > 0.0:
                inside = np.flatnonzero((relation.rows >= gap[0]) & (relation.rows <= gap[-1]))
                ends = np.array([r for r in (inside[0] - 1, inside[-1] + 1) if 0 <= r < len(relation.rows)], dtype=int)
                found[gap, m] += share * (relation.predicted(inside, ends) - body[gap, m])
    return found


def _share_of(
    relation: Relation, length: int, measured: np.ndarray, off: np.ndarray, bones: np.ndarray, lasting: float
) -> float:
    """Return the weight of a relation against the body in gaps of a length of frames, 0 where nothing tells it."""
    trials = relation.trials(length) if relation.known.sum() >= LEAST_ROWS else []
    if len(trials) < LEAST_TRIALS:
        return 0.0
    by_body, by_others = 0.0, 0.0
    for inside, ends in trials:
        frames, outer = relation.rows[inside], relation.rows[ends]
        rest = off[frames] - between_ends(frames, outer, off[outer], lasting)
        by_body += HIDDEN**2 * float(np.square(bones[frames] @ rest[..., None]).sum())
        by_others += float(np.square(relation.predicted(inside, ends) - measured[frames]).sum())
    return by_body / max(by_body + by_others, 1e-12)


def lasting_frames(off: np.ndarray, lag: int) -> float:
    """Return τ in frames of ``exp(-t / τ)``, the correlation over a time t of (F, M, 3) errors, NaN where missing."""
    early, late = off[:-lag], off[lag:]
    both = np.isfinite(early) & np.isfinite(late)
    early, late = np.where(both, early, 0.0), np.where(both, late, 0.0)
    power = float(np.sqrt((early**2).sum() * (late**2).sum()))
    correlation = np.clip(float((early * late).sum()) / max(power, 1e-12), *CORRELATION)
    return float(-lag / np.log(correlation))


def bone_rotations(landmarks: Landmarks, rotations: np.ndarray) -> np.ndarray:
    """Return (F, M, 3, 3) the mixed rotations of the landmarks' bones, from (F, J, 3, 3) global ones."""
    frames, count = len(rotations), len(landmarks)
    return (landmarks.weights @ rotations.reshape(frames, -1, 9)).reshape(frames, count, 3, 3)
