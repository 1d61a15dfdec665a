"""How late all cameras are, and how that drifts, in one least-squares problem with the points eliminated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.cameras.projection import project_with_jacobian
from solver_backend.geometry.symmetric import inverse_symmetric_3x3
from solver_backend.types import Cameras

ROBUST_SIGMAS = 3.0
"""Scale of the Geman-McClure weights."""
DEPTH_SIGMA_M = 0.5
"""How far a point may lie from where it was triangulated."""
BLOCKS = 8
"""Stretches of the take with independent errors, from whose disagreement the deviations are estimated."""

MOST_NUMBERS = 4_000_000
"""Of the rows that are in memory at once: 32 MB a copy; more views than that stand in several parts."""


@dataclass(frozen=True)
class DelayStep:
    """A Gauss-Newton step on the delays, and where the points move by it."""

    delay: np.ndarray
    """(C,) frames."""
    drift: np.ndarray
    """(C,) frames from the middle of the take to its end."""
    sigma: np.ndarray
    """(C,) standard deviation of the delays."""
    drift_sigma: np.ndarray
    """(C,) the same of the drifts."""
    points: np.ndarray
    """(N, K, 3) metres."""


def delay_step(
    cameras: Cameras,
    xy: np.ndarray,
    velocity: np.ndarray,
    points: np.ndarray,
    at: np.ndarray,
    sigma_px: np.ndarray,
    *,
    drifting: bool,
    blocks: int = BLOCKS,
) -> DelayStep:
    """Return one step on the delays of all cameras.

    A detection of camera c that is read by ``δ_c + τ ε_c`` frames later is ``x + (δ_c + τ ε_c) v``. What is least in
    ``Σ w |x + (δ + τ ε) v - π(X) - J ξ - b|²`` over the delays δ, the drifts ε, the points' steps ξ and a constant b
    for every view and keypoint, which an inexact calibration causes; only differences between cameras are estimated.
    The covariance is the sandwich ``H⁻¹ (Σ g_b g_bᵀ) H⁻¹`` over blocks of frames, for errors of neighbouring frames are
    correlated.

    Args:
        cameras: C cameras.
        xy: (C, N, K, 2) px, NaN where missing.
        velocity: (C, N, K, 2) px a frame.
        points: (N, K, 3) metres, NaN where unknown.
        at: (N,) the frames' place in the take, -1 at its first, 1 at its last.
        sigma_px: (K,) or (C, N, K) standard deviation of the detections, px.
        drifting: look for drifts; else they are zero.
        blocks: stretches of the take with independent errors; the deviations need several times as many as cameras.

    Reference: Lucas and Kanade 1981 (the shift that aligns two signals); Golub and Pereyra 1973 (the elimination);
    Liang and Zeger 1986 (the covariance).
    """
    px, J, _ = project_with_jacobian(
        cameras.K, cameras.distortion, cameras.R, cameras.t, points, cameras.distortion_model
    )
    error = xy - px
    known = np.isfinite(error).all(-1) & np.isfinite(velocity).all(-1)
    known &= known.sum(axis=0) >= 2
    error, velocity = (np.where(known[..., None], a, 0.0) for a in (error, velocity))
    J = np.where(known[..., None, None], J, 0.0)
    scale = (ROBUST_SIGMAS * sigma_px) ** 2
    weight = known * (scale / (scale + (error**2).sum(-1))) ** 2 / sigma_px**2
    pull = np.swapaxes(J, -1, -2) * weight[..., None, None]
    spread = inverse_symmetric_3x3((pull @ J).sum(axis=0) + np.eye(3) / DEPTH_SIGMA_M**2)
    moved = (spread @ (pull @ velocity[..., None]))[..., 0]
    shift = (spread @ (pull @ error[..., None]).sum(axis=0))[..., 0]
    error = _centred(error - (J @ shift[..., None])[..., 0], weight)
    kinds = 2 if drifting else 1
    ramps = np.stack([np.ones_like(at), at])[:kinds]
    step, sigma = _solved(*_equations(_Rows(J, moved, velocity, error, weight), ramps, blocks), kinds)
    late = step.T @ ramps
    points = points + np.nan_to_num(shift - np.einsum("pn,pnkj->nkj", late, moved, optimize=True))
    none = np.zeros(len(cameras))
    delay, drift = step if drifting else (step[0], none)
    return DelayStep(delay, drift, sigma[0], sigma[-1] if drifting else none, points)


@dataclass(frozen=True)
class _Rows:
    """What the rows of the least-squares problem are made of."""

    J: np.ndarray
    """(C, N, K, 2, 3) of the detections by the points."""
    moved: np.ndarray
    """(C, N, K, 3) how a point follows the velocity in each view."""
    velocity: np.ndarray
    """(C, N, K, 2) px a frame."""
    error: np.ndarray
    """(C, N, K, 2) px, with the points' own steps taken out."""
    weight: np.ndarray
    """(C, N, K)"""

    def of_views(self, views: slice, ramps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the weighted rows (B, V, N, K, 2) of V views, B = C for every ramp, and their (V, N, K, 2) errors."""
        own, weight = np.arange(len(self.J))[views], self.weight[views]
        basis = -np.einsum("cnkij,pnkj->pcnki", self.J[views], self.moved, optimize=True)
        basis[own, own - own[0]] += self.velocity[views]
        # The first ramp is 1 throughout.
        columns = [_centred(basis if k == 0 else basis * ramp[:, None, None], weight) for k, ramp in enumerate(ramps)]
        root = np.sqrt(weight)[..., None]
        return np.stack(columns).reshape(-1, *basis.shape[1:]) * root, self.error[views] * root


def _equations(rows: _Rows, ramps: np.ndarray, count_of_blocks: int) -> tuple[np.ndarray, np.ndarray]:
    """Return normal matrices (blocks, B, B) and gradients (blocks, B), summed over parts of the views."""
    count, frames = rows.error.shape[:2]
    blocks = np.array_split(np.arange(frames), min(count_of_blocks, frames))
    size = len(ramps) * count
    normal, gradient = np.zeros((len(blocks), size, size)), np.zeros((len(blocks), size))
    step = max(1, MOST_NUMBERS // max(size * rows.error[0].size, 1))
    for first in range(0, count, step):
        columns, residual = rows.of_views(slice(first, first + step), ramps)
        for number, block in enumerate(blocks):
            a = columns[:, :, block].reshape(size, -1)
            normal[number] += a @ a.T
            gradient[number] += a @ residual[:, block].reshape(-1)
    return normal, gradient


def _solved(normal: np.ndarray, gradient: np.ndarray, kinds: int) -> tuple[np.ndarray, np.ndarray]:
    """Return least-squares steps (kinds, C) and their deviations; each row has mean zero."""
    count = normal.shape[-1] // kinds
    total = normal.sum(axis=0)
    alike = np.kron(np.eye(kinds), np.ones((count, count))) * (np.trace(total) / len(total) ** 2)
    inverse = np.linalg.pinv(total + alike + 1e-9 * np.eye(len(total)), hermitian=True)
    step = -inverse @ gradient.sum(axis=0)
    left = gradient + normal @ step
    spread = inverse @ (left.T @ left) @ inverse * (len(normal) / max(len(normal) - 1, 1))
    sigma = np.sqrt(np.maximum(np.diag(spread), np.diag(inverse)))
    return step.reshape(kinds, count), sigma.reshape(kinds, count)


def _centred(values: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Return (..., C, N, K, 2) values less their weighted means over the frames."""
    total = np.maximum(weight.sum(axis=1, keepdims=True), 1e-12)[..., None]
    return values - (weight[..., None] * values).sum(axis=-3, keepdims=True) / total
