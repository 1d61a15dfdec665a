"""Fill marker gaps, using the fitted body and neighbouring markers."""

from __future__ import annotations

import numpy as np

from solver_backend.body.landmarks import Landmarks
from solver_backend.geometry.alignment import nearest_rotation
from solver_backend.geometry.arrays import true_runs
from solver_backend.geometry.small_matrices import solved_3x3

NEIGHBOURS, FEWEST = 6, 3
"""Number of neighbours that predict a gap, and smallest number of them, which determines an orientation."""
MOSTLY = 0.5  # Smallest share of a gap in which a neighbour is visible. The fitted body provides the rest.
FAR = 0.01  # Assumed relative deviation of a distance, because distant markers are on other limbs.
FRAMES = 60  # Number of frames in which distances are measured. More frames barely change the order.
ROWS, WINDOW_S = 300, 10.0  # Number of training frames for a gap, and time span before and after it that contains them.
NOISE_M = 0.00055  # Noise of a neighbour's position in metres, as for an optical tracker.
ROWS_BY_NEIGHBOUR = 3  # Smallest number of frames per neighbour, because each neighbour has three unknowns.
HIDDEN = 5.0  # Ratio between the errors of a hidden marker and of a visible one, which attracts the body.
"""These constants were chosen on 19 gap fillings in 12 takes (marker_files.md). Half the window, 0.3 mm, 8 neighbours
or a factor of 2 increase the mean error by 3 to 7 %, a ``FAR`` of 0.005 by 2 %, and a ``MOSTLY`` of 1 by 3 %."""


def steadiest_first(points: np.ndarray, pool: np.ndarray) -> np.ndarray:
    """For each marker, sort the points in ``pool`` by how constant their distance from it is. Return indices (M, N).

    If all variances are small, as for a person who stands still, near points come first. Missing points are NaN. Points
    that are visible together with the marker in fewer than two sampled frames come last.
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
    """Predict a marker's positions (n, 3) in a gap from its neighbours, with squared errors in m².

    The prediction uses axes that move with the neighbours (Kabsch 1976). In these axes, v are the neighbours'
    positions, and ``u = W v`` is the marker's position, found by ridge regression. The errors of the prediction at the
    gap's ends are interpolated to correct the prediction inside the gap. V are the neighbours' positions in the n'
    frames that show the marker, the training frames. With ``h = vᵀ (VᵀV)⁻¹ v``, the squared error is the training error
    times ``1 + n' h + (h / h_max)²``. Errors of W grow linearly with the distance of v from the training frames, and
    errors from nonlinear movement quadratically. h_max is the largest h of a training frame.

    Args:
        points: (R, 3) positions of the marker in metres, only used where ``known`` (R,).
        near: (R, K, 3) positions of the neighbours in metres.
        rows: (R,) ascending frame numbers, including all of the (n,) ``gap`` and its ends.
        lasting: correlation time of the error in frames.

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
    most = (A[known] * np.linalg.solve(M, A[known].T).T).sum(axis=1).max()
    squared = np.square(missed[known]).sum() / free * (1.0 + count * beyond + (beyond / max(most, 1e-12)) ** 2)
    return middles[inside] + (turns[inside] @ local[..., None])[..., 0], squared


def joining_shares(times: np.ndarray, length: int, lasting: float) -> np.ndarray:
    """Return the weight of the error at a gap's start in frames t (``times``) of the gap's n frames.

    The weight is ``sinh((n + 1 - t) / τ) / sinh((n + 1) / τ)``, where τ is ``lasting``.
    """
    away, span = times / lasting, (length + 1) / lasting
    return np.exp(-away) * np.expm1(-2 * (span - away)) / np.expm1(-2 * span)  # cannot overflow in long gaps


def between_ends(frames: np.ndarray, ends: np.ndarray, errors: np.ndarray, lasting: float) -> np.ndarray:
    """Return the expected errors (n, 3) in the frames of a gap, given the errors at its ends.

    The errors are assumed to be an Ornstein-Uhlenbeck process with a correlation time of ``lasting`` frames.
    """
    since = np.abs(frames - ends[:, None])
    share = joining_shares(since, ends[1] - ends[0] - 1, lasting) if len(ends) == 2 else np.exp(-since / lasting)
    return share.T @ errors


LAG_S, LONGER = 0.2, 3.0
"""Lag in seconds at which the error correlation is measured, and factor applied to the correlation time in gaps,
because the fit of visible markers removes slow errors."""
CORRELATION = (0.01, 0.98)  # Limits of this correlation.


def filled(
    measured: np.ndarray, solved: np.ndarray, bones: np.ndarray, fps: float, others: np.ndarray | None = None
) -> np.ndarray:
    """Fill the gaps of markers (F, M, 3) with the weighted mean of two predictions.

    The first prediction is the marker y on the body, corrected at both ends a and b of the gap:
    ``x(t) = y(t) + B(t) [ sinh((b - t) / τ) d_a + sinh((t - a) / τ) d_b ] / sinh((b - a) / τ)``. The errors
    ``d = B⁻¹ (x - y)`` at the ends are in the axes B of the marker's bones. The factor of B(t) is the mean of an
    Ornstein-Uhlenbeck process. For a gap with only one end, it is ``d_a e^{-(t - a) / τ}`` instead. τ is estimated from
    the take.

    The second prediction comes from the neighbours (see ``among``). Frames around the gap give the mean squared errors
    ``e_1²`` and ``e_2²``. The second prediction has the weight ``e_1² / (e_1² + e_2²)``. If the predictions differ by
    more than these errors, ``e_1²`` is increased, because the body's pose is undetermined for a limb with no visible
    marker.

    ``bones`` are (F, M, 3, 3) weighted mean rotations of each marker's bones. ``others`` are (F, U, 3) recorded points
    that the body does not use. They predict markers of limbs without other known markers.

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
    """Estimate the correlation time τ of the body's errors in frames."""
    early, late = off[:-lag], off[lag:]
    both = np.isfinite(early) & np.isfinite(late)
    early, late = np.where(both, early, 0.0), np.where(both, late, 0.0)
    power = float(np.sqrt((early**2).sum() * (late**2).sum()))
    correlation = np.clip(float((early * late).sum()) / max(power, 1e-12), *CORRELATION)
    return float(-lag / np.log(correlation))


def bone_rotations(landmarks: Landmarks, rotations: np.ndarray) -> np.ndarray:
    """Return the mean rotations (F, M, 3, 3) of the bones that each landmark is on."""
    frames, count = len(rotations), len(landmarks)
    return (landmarks.weights @ rotations.reshape(frames, -1, 9)).reshape(frames, count, 3, 3)
