"""Fill gaps of markers with the body's marker and with the marker's own place among its neighbours."""

from __future__ import annotations

import numpy as np

from solver_backend.body.landmarks import Landmarks
from solver_backend.geometry.alignment import nearest_rotation
from solver_backend.geometry.arrays import true_runs
from solver_backend.geometry.small_matrices import solved_3x3

NEIGHBOURS, FEWEST = 6, 3
"""Markers that predict a gap: the steadiest ones, and the fewest that have an orientation."""
MOSTLY = 0.5  # Least share of a gap in which a worn neighbour is seen. The body has it for the rest.
FAR = 0.01  # Deviation of a distance in frames not yet seen, by the distance: what is far is on another limb.
FRAMES = 60  # Frames in which distances are measured. The order changes little with more.
ROWS, WINDOW_S = 300, 10.0  # Frames to learn a gap from, and the time before and after it that they are from.
NOISE_M = 0.00055  # Deviation of a neighbour's place that tells nothing, as of an optical tracker.
ROWS_BY_NEIGHBOUR = 3  # A regression has three unknowns for each neighbour, and needs more frames.
FOREIGN = 150.0  # Deviations of the neighbours from their mean beyond which they tell nothing, by the known rows.
HIDDEN = 5.0  # Error of the body's hidden marker by a seen one's, which draws the body to itself.
"""Chosen on 19 fillings of 12 takes: half the window, 0.3 mm, 8 neighbours or a factor of 2 raise the mean error by 3
to 7 %, a ``FAR`` of 0.005 by 2 %, a ``MOSTLY`` of 1 by 3 %.
See "Neighbours of hidden markers" in docs/research-log/marker_files.md."""


def steadiest_first(points: np.ndarray, pool: np.ndarray) -> np.ndarray:
    """Return for each of (F, M, 3) points the (M, N) points of a (F, N, 3) pool, the steadiest distance first.

    Of equally steady ones the nearest is first: of a person who stands still all distances are steady. Missing points
    are NaN. Two that are seen together in fewer than two of the frames come last.
    """
    some = np.unique(np.linspace(0, len(points) - 1, FRAMES).astype(int))
    away = np.linalg.norm(points[some, :, None] - pool[some][:, None], axis=-1)
    there = np.isfinite(away)
    count, away = there.sum(axis=0), np.where(there, away, 0.0)
    mean = away.sum(axis=0) / np.maximum(count, 1)
    spread = np.where(there, away - mean, 0.0)
    variance = np.where(count > 1, np.square(spread).sum(axis=0) / np.maximum(count, 1), np.inf)
    return np.argsort(variance + (FAR * mean) ** 2, axis=1, kind="stable")


def among(
    points: np.ndarray, near: np.ndarray, rows: np.ndarray, known: np.ndarray, gap: np.ndarray, lasting: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return a marker's (n, 3) places in a gap by its place among its neighbours, and their (n,) squared errors, m².

    In the frame that turns and moves with the neighbours (Kabsch 1976), the marker's place is ``u = W v`` by ridge
    regression, where v are the neighbours' places. So v is what a rigid cluster lacks: how the neighbours move within
    it. The errors at the gap's ends continue into it. The squared error is that of the known rows times
    ``1 + R vᵀ (VᵀV)⁻¹ v``: it grows where the neighbours are as in no known row, and is infinite
    where they are far beyond.

    Args:
        points: (R, 3) metres, the marker's places, only used if ``known`` (R,).
        near: (R, K, 3) metres.
        rows: (R,) frames, in order, with all of the ``gap``, (n,), and its ends.
        lasting: correlation time of the error, frames.

    Reference: Hoerl and Kennard 1970, "Ridge regression", eq. 2.1.
    """
    middles = near.mean(axis=1)
    cluster = near - middles[:, None]
    turns = nearest_rotation(cluster.swapaxes(1, 2) @ cluster[0])
    within = (cluster @ turns).reshape(len(rows), -1)
    places = ((points - middles)[:, None] @ turns)[:, 0]
    A = within - within[known].mean(axis=0)
    usual, count = places[known].mean(axis=0), int(known.sum())
    ridge = count * NOISE_M**2 * np.eye(A.shape[1])
    M = A[known].T @ A[known] + ridge
    W = np.linalg.solve(M, A[known].T @ (places[known] - usual))
    told = usual + A @ W
    missed = places - told
    first = int(np.searchsorted(rows, gap[0]))
    inside = slice(first, first + len(gap))
    ends = np.array([r for r in (first - 1, inside.stop) if 0 <= r < len(rows)], dtype=int)
    local = told[inside] + between_ends(gap, rows[ends], missed[ends], lasting)
    free = max(count - A.shape[1] - 1, 1)
    beyond = (A[inside] * np.linalg.solve(M, A[inside].T).T).sum(axis=1)
    squared = np.square(missed[known]).sum() / free * (1.0 + count * beyond)
    if count * beyond.mean() > FOREIGN**2:
        squared[:] = np.inf
    return middles[inside] + (turns[inside] @ local[..., None])[..., 0], squared


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


def filled(
    measured: np.ndarray, solved: np.ndarray, bones: np.ndarray, fps: float, others: np.ndarray | None = None
) -> np.ndarray:
    """Return (F, M, 3) markers: as measured, and in gaps the mean of two predictions.

    The first is the body's marker, corrected to meet both ends:
    ``x(t) = y(t) + B(t) [ sinh((b - t) / τ) d_a + sinh((t - a) / τ) d_b ] / sinh((b - a) / τ)`` in a gap from a to b,
    with the body's marker y and its error at the ends in its bones' frame B, ``d = B⁻¹ (x - y)``: the mean of an
    Ornstein-Uhlenbeck process between its ends, ``d_a e^{-(t - a) / τ}`` in a gap with one end. τ follows from the
    take: errors last in slow movement and change within a stride.
    The second is the marker's place among its neighbours (``among``). The frames around the gap tell the mean squared
    errors ``e²`` of both, and the second has the weight ``e_1² / (e_1² + e_2²)``. If both differ by more than that, the
    body is wrong: a limb whose only marker is hidden goes anywhere.
    ``bones`` are (F, M, 3, 3) mixed rotations of each marker's bones. ``others`` are (F, U, 3) points of the recording
    that the body does not wear: of a limb without known markers, they alone tell where a marker is.

    Reference: Uhlenbeck and Ornstein 1930, "On the theory of the Brownian motion".
    """
    body, seen, count = measured.copy(), np.isfinite(measured).all(-1), len(measured)
    off = solved_3x3(bones, measured - solved)
    lasting = LONGER * lasting_frames(off, max(1, round(LAG_S * fps)))
    gaps = [(m, np.arange(a, b + 1)) for m in np.flatnonzero(~seen.all(axis=0)) for a, b in true_runs(~seen[:, m])]
    for m, gap in gaps:
        ends = np.array([end for end in (gap[0] - 1, gap[-1] + 1) if 0 <= end < count], dtype=int)
        joined = between_ends(gap, ends, off[ends, m], lasting)
        body[gap, m] = solved[gap, m] + (bones[gap, m] @ joined[..., None])[..., 0]
    found = body.copy()
    if not gaps:
        return found
    more = np.empty((count, 0, 3)) if others is None else others[:, 2 * np.isfinite(others).all(-1).sum(axis=0) > count]
    pool = np.concatenate([measured, more], axis=1)
    order, whole = steadiest_first(measured, pool), np.isfinite(pool).all(-1)
    pool[:, : body.shape[1]] = body
    window = round(WINDOW_S * fps)
    step = -(-min(2 * window, count) // ROWS)
    for m, gap in gaps:
        span = slice(max(gap[0] - 1, 0), gap[-1] + 2)
        throughout = (whole[span].mean(axis=0) >= MOSTLY) & np.isfinite(pool[span]).all(axis=(0, 2))
        near = order[m][throughout[order[m]]][:NEIGHBOURS]
        before = np.arange(gap[0] - 1, max(gap[0] - 2 - window, -1), -step)[::-1]
        rows = np.concatenate([before, gap, np.arange(gap[-1] + 1, min(gap[-1] + 2 + window, count), step)])
        rows = rows[np.isfinite(pool[rows[:, None], near]).all(axis=(1, 2))]
        known = seen[rows, m]
        if len(near) >= FEWEST and known.sum() > ROWS_BY_NEIGHBOUR * len(near) + 1:
            places, by_others = among(body[rows, m], pool[rows[:, None], near], rows, known, gap, lasting)
            error = off[rows[known], m]
            by_body = HIDDEN**2 * float(np.square(error - error.mean(axis=0)).sum(axis=1).mean())
            apart = np.square(places - body[gap, m]).sum(axis=1) - by_others
            by_body = max(by_body, float(apart.mean()))
            share = by_body / np.maximum(by_body + by_others, 1e-18)
            found[gap, m] += share[:, None] * (places - body[gap, m])
    return found


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
