"""By how many whole frames each camera lags, from the pairs of views: points of one moment meet epipolar lines."""

from __future__ import annotations

import numpy as np

from solver_backend.cameras.camera_pairs import COMPARED, compared_pairs
from solver_backend.cameras.projection import undistort
from solver_backend.exchange.progress import Progress, silent
from solver_backend.geometry.quantiles import quantile
from solver_backend.types import Cameras

ROBUST_SIGMAS = 3.0
"""Scale of the Geman-McClure penalty of a distance to an epipolar line."""
LEAST_SHARE = 0.3
"""A lag is evaluated where at least this share of the most common points is left."""
STAGE = "Comparing the clocks"
ROUNDS = 10
"""Rounds of reweighting at most; chosen by hand."""


def whole_lags(
    cameras: Cameras, tracks: np.ndarray, frames: np.ndarray, sigma_px: np.ndarray, reach: int,
    progress: Progress = silent,
) -> np.ndarray:  # fmt: skip
    """Return (C,) whole frames by which cameras lag behind the first, that make all pairs of views agree best.

    For every pair (``compared_pairs``) a table over its lags holds how far points are from the other's epipolar lines;
    the lags of all cameras are those of least sum over the pairs, by descent along one camera after the other from the
    own view of the others that each of ``COMPARED`` cameras has.

    Args:
        cameras: C cameras.
        tracks: (C, F, K, 2) px, NaN where missing.
        frames: (N,) numbers of the frames that are compared.
        sigma_px: (K,) standard deviation of the detections, px.
        reach: largest lag looked for.
        progress: called as pairs are compared.

    Reference: Hartley and Zisserman 2004, "Multiple View Geometry", sec. 9.6 (the essential matrix) and eq. 11.9
    (Sampson's distance); Besag 1986 (descent along one variable after the other).
    """
    count = len(cameras)
    tables = np.zeros((count, count, 2 * reach + 1))
    at = frames + np.arange(-reach, reach + 1)[:, None]
    inside = np.clip(at, 0, tracks.shape[1] - 1)
    looked_at = np.unique(inside)
    normalised = undistort(cameras.K, cameras.distortion, tracks[:, looked_at], cameras.distortion_model)
    seen = np.concatenate([normalised, np.ones_like(normalised[..., :1])], axis=-1)
    place, outside = np.searchsorted(looked_at, inside), at != inside
    pairs = compared_pairs(count)
    for number, (i, j) in enumerate(pairs):
        progress(STAGE, number, len(pairs))
        distance = _distances(cameras, i, j, seen, place)
        distance[outside] = np.nan
        tables[i, j] = _robust_means(distance, ROBUST_SIGMAS * sigma_px)
        tables[j, i] = tables[i, j, ::-1]
    progress(STAGE, len(pairs), len(pairs))
    compared = tables.any(axis=-1, keepdims=True)
    firsts = np.unique(np.linspace(0, count - 1, min(count, COMPARED)).astype(int))
    starts = [np.where(compared[start, :, 0], tables[start].argmin(axis=-1) - reach, 0) for start in firsts]
    found = [
        _descended(tables, np.where(np.arange(count) == s, 0, lags)) for s, lags in zip(firsts, starts, strict=True)
    ]
    return min(found, key=lambda lags: _total(tables, lags))


def _distances(cameras: Cameras, i: int, j: int, seen: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Return (L, N, K) px from what view j sees a lag later to the epipolar lines of what view i sees.

    Args:
        cameras: C cameras.
        i: the view that does not move.
        j: the view that does.
        seen: (C, P, K, 3) undistorted points.
        place: (L, N) which of the P frames is looked at for a lag and a frame; the middle row is for none.
    """
    R = cameras.R[j] @ cameras.R[i].T
    x, y, z = cameras.t[j] - R @ cameras.t[i]
    essential = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]) @ R
    line = seen[i][place[len(place) // 2]] @ essential.T
    back = (seen[j] @ essential)[..., :2]
    square = (line[..., :2] ** 2).sum(-1) + (back**2).sum(-1)[place]
    focal = 0.25 * (np.trace(cameras.K[i, :2, :2]) + np.trace(cameras.K[j, :2, :2]))
    return focal * np.einsum("lnkx,nkx->lnk", seen[j][place], line) / np.sqrt(square)


def _robust_means(distance: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Return (L,) means of ``r²/(r² + s²)`` of (L, N, K) distances less their medians, 1 where few are known.

    The median over the frames is what an inexact calibration causes.
    """
    square = (distance - quantile(distance, 0.5, axis=1, method="lower")[:, None]) ** 2
    share = square / (square + scale**2)
    known = np.isfinite(share)
    number = known.sum(axis=(1, 2))
    enough = number >= np.maximum(LEAST_SHARE * number.max(), 1)
    return np.where(enough, np.where(known, share, 0.0).sum(axis=(1, 2)) / np.maximum(number, 1), 1.0)


def _descended(tables: np.ndarray, lags: np.ndarray) -> np.ndarray:
    """Return lags that no change of a single camera betters."""
    reach = tables.shape[-1] // 2
    tried = np.arange(-reach, reach + 1)
    for _ in range(ROUNDS):
        before = lags.copy()
        for camera in range(len(lags)):
            others = np.arange(len(lags)) != camera
            between = lags[others][:, None] - tried
            cost = _looked_up(tables[camera][others], between).sum(axis=0)
            lags[camera] = tried[cost.argmin()]
        if (lags == before).all():
            break
    return lags - lags[0]


def _looked_up(tables: np.ndarray, lags: np.ndarray) -> np.ndarray:
    """Return the entries of (P, 2 reach + 1) tables at (P, ...) lags, 1 beyond their reach."""
    reach = tables.shape[-1] // 2
    inside = np.abs(lags) <= reach
    found = np.take_along_axis(tables, np.clip(lags, -reach, reach) + reach, axis=-1)
    return np.where(inside, found, 1.0)


def _total(tables: np.ndarray, lags: np.ndarray) -> float:
    """Return the sum over all pairs."""
    first, second = np.triu_indices(len(lags), 1)
    return float(_looked_up(tables[first, second], (lags[second] - lags[first])[:, None]).sum())
