"""How two cameras stand to each other, from points that both see: the essential matrix, robustly."""

from __future__ import annotations

import numpy as np

from solver_backend.types.shapes import Bool, Float

HYPOTHESES = 400
"""Samples of eight points."""
COMPARED_POINTS = 600
"""Points on which the samples are compared."""
_REFINEMENTS = 6
"""Gauss-Newton steps; chosen by hand."""

ImagePoints = Float[np.ndarray, "n 2"]
"""Undistorted normalised coordinates."""


def essential_matrix(
    first: ImagePoints, second: ImagePoints, scale: float, rng: np.random.Generator
) -> tuple[Float[np.ndarray, "3 3"], Bool[np.ndarray, " n"]]:
    """Return E with ``x2ᵀ E x1 = 0`` and which points agree with it.

    Samples of eight points propose, Cauchy's penalty of Sampson's distance decides, and the best is refined with its
    weights.

    Args:
        first: (n, 2) normalised, n at least 8.
        second: (n, 2) the same points in the other picture.
        scale: distance at which a point loses its weight, normalised units.
        rng: seeded.

    Reference: Hartley 1997, "In defense of the eight-point algorithm"; Torr and Zisserman 2000, "MLESAC"; Hartley and
    Zisserman 2004, eq. 11.9 (Sampson's distance).
    """
    spread = float(np.sqrt((first**2).mean() + (second**2).mean()))
    rows = _rows(first / spread, second / spread)
    picks = np.stack([rng.permutation(len(first))[:8] for _ in range(HYPOTHESES)])
    candidates = _essential(np.linalg.svd(rows[picks])[2][:, -1].reshape(-1, 3, 3), spread)
    compared = rng.permutation(len(first))[:COMPARED_POINTS]
    distance = sampson_distance(candidates, first[compared], second[compared])
    best = candidates[int(np.argmin(np.log1p((distance / scale) ** 2).sum(-1)))]
    for _ in range(_REFINEMENTS):
        distance = sampson_distance(best[None], first, second)[0]
        x1, x2 = _homogeneous(first), _homogeneous(second)
        slope = np.sqrt(((x1 @ best.T)[:, :2] ** 2).sum(-1) + ((x2 @ best)[:, :2] ** 2).sum(-1))
        weight = 1.0 / (1.0 + (distance / scale) ** 2) / np.maximum(slope, 1e-9)
        refined = np.linalg.svd(rows * weight[:, None], full_matrices=False)[2][-1].reshape(1, 3, 3)
        refined = _essential(refined, spread)[0]
        costs = [np.log1p((sampson_distance(E[None], first, second)[0] / scale) ** 2).sum() for E in (best, refined)]
        if costs[1] >= costs[0]:
            break
        best = refined
    return best, sampson_distance(best[None], first, second)[0] < 3.0 * scale


def sampson_distance(
    E: Float[np.ndarray, "m 3 3"], first: ImagePoints, second: ImagePoints
) -> Float[np.ndarray, "m n"]:
    """Return how far pairs of points are from fitting, in normalised units, to first order.

    Reference: Hartley and Zisserman 2004, eq. 11.9.
    """
    x1, x2 = _homogeneous(first), _homogeneous(second)
    line2, line1 = x1 @ np.swapaxes(E, 1, 2), x2 @ E
    product = (line2 * x2).sum(-1)
    slope = (line2[..., :2] ** 2).sum(-1) + (line1[..., :2] ** 2).sum(-1)
    return np.abs(product) / np.sqrt(np.maximum(slope, 1e-18))


def pose_from_essential(
    E: Float[np.ndarray, "3 3"], first: ImagePoints, second: ImagePoints
) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, " 3"]]:
    """Return the second camera's rotation and unit translation, the first at the origin: most points before both.

    Reference: Hartley and Zisserman 2004, result 9.19.
    """
    U, _, Vt = np.linalg.svd(E)
    U, Vt = U * np.sign(np.linalg.det(U)), Vt * np.sign(np.linalg.det(Vt))
    W = np.array([[0, -1.0, 0], [1, 0, 0], [0, 0, 1]])
    best: tuple[int, np.ndarray, np.ndarray] = (-1, np.eye(3), U[:, 2])
    for R in (U @ W @ Vt, U @ W.T @ Vt):
        for t in (U[:, 2], -U[:, 2]):
            X = intersected(np.stack([np.eye(3), R]), np.stack([np.zeros(3), t]), np.stack([first, second]))
            before = int(((X[:, 2] > 0) & ((X @ R.T + t)[:, 2] > 0)).sum())
            if before > best[0]:
                best = before, R, t
    return best[1], best[2]


def intersected(
    R: Float[np.ndarray, "views 3 3"], t: Float[np.ndarray, "views 3"], xy: Float[np.ndarray, "views n 2"]
) -> Float[np.ndarray, "n 3"]:
    """Return the points nearest to the rays of all views that see them, NaN where fewer than two do.

    Args:
        R: (V, 3, 3) world to camera.
        t: (V, 3).
        xy: (V, n, 2) normalised, NaN where not seen.

    Reference: Slabaugh, Schafer and Livingston 2001, "Optimal ray intersection".
    """
    seen = np.isfinite(xy).all(-1)
    ray = np.where(seen[..., None], _homogeneous(np.nan_to_num(xy)), 0.0) @ R
    length = np.linalg.norm(ray, axis=-1, keepdims=True)
    ray = ray / np.where(length > 0, length, 1.0)
    along: np.ndarray = ray[..., None] * ray[..., None, :]
    across = np.subtract(np.eye(3), along) * seen[..., None, None]
    centre: np.ndarray = np.negative((np.swapaxes(R, 1, 2) @ t[..., None])[..., 0])
    A, b = across.sum(0), (across @ centre[:, None, :, None])[..., 0].sum(0)
    enough = (seen.sum(0) >= 2) & (np.abs(np.linalg.det(A)) > 1e-9)
    X = np.linalg.solve(np.where(enough[:, None, None], A, np.eye(3)), b[..., None])[..., 0]
    return np.where(enough[:, None], X, np.nan)


def _rows(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    return (_homogeneous(second)[:, :, None] * _homogeneous(first)[:, None, :]).reshape(-1, 9)


def _essential(F: np.ndarray, spread: float) -> np.ndarray:
    """Return (m, 3, 3) the nearest essential matrices of those of coordinates that were divided by ``spread``."""
    scale = np.diag([1.0 / spread, 1.0 / spread, 1.0])
    U, _, Vt = np.linalg.svd(scale @ F @ scale)
    return U @ (np.array([1.0, 1.0, 0.0])[:, None] * Vt)


def _homogeneous(xy: np.ndarray) -> np.ndarray:
    return np.concatenate([xy, np.ones_like(xy[..., :1])], axis=-1)
