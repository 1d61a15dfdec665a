"""Check lenses: fit focal lengths and small rotations of the cameras to views of one person.

Gauss-Newton steps with Cauchy weights minimise the distances of points from epipolar lines. Every camera may rotate
slightly, so that an inexact calibration is not mistaken for another fault.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np

from solver_backend.agreement.evidence import (
    BLOCKS,
    EACH,
    LEAST_CAMERAS,
    LEAST_NOISE,
    MOST_ROUNDS,
    MOVED,
    POSES,
    epipolar_distances,
)
from solver_backend.agreement.hypotheses import CONVERGED, SPREAD
from solver_backend.agreement.person_tracks import SMALLEST_ANGLE_SIN2
from solver_backend.agreement.reading import MIN_CONFIDENCE, extent, sample
from solver_backend.agreement.synchronisation import USUAL_SIGMA_SHARE
from solver_backend.cameras.projection import undistort
from solver_backend.cameras.robust_triangulation import INLIER_SIGMAS, ROBUST_SIGMAS
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.geometry.arrays import quantile
from solver_backend.geometry.rotations import exp_so3
from solver_backend.geometry.small_matrices import unit
from solver_backend.types import Cameras, Keypoints2D

_STEP = np.sqrt(np.finfo(float).eps)  # Step of numerical derivatives, for half of the digits.


@dataclass(frozen=True)
class EpipolarFit:
    """Focal length factor and rotations of C cameras that minimise the epipolar distances."""

    log: float  # Logarithm of the factor missing in the focal lengths.
    sigma: float  # Its standard deviation.
    turns: np.ndarray  # (3 C,) rotations of the cameras in radians.

    @property
    def is_sure(self) -> bool:
        """True if the focal length factor is significant, and no rotation exceeds usual calibration errors."""
        is_calibrated = np.abs(self.turns).max() < 3 * USUAL_SIGMA_SHARE
        return bool(is_calibrated and abs(self.log) >= max(MOVED, INLIER_SIGMAS * self.sigma))


@dataclass(frozen=True)
class ComparedViews:
    """Cameras and their detections of one person."""

    cameras: Cameras
    xy: np.ndarray  # (C, F, J, 2) px, NaN where unseen.

    @classmethod
    def of(cls, cameras: Cameras, keypoints: Keypoints2D) -> ComparedViews | None:
        """Select up to ``EACH`` views and ``POSES`` frames. Return None without frames or with too few cameras."""
        if len(cameras) < LEAST_CAMERAS or not keypoints.num_frames:
            return None
        chosen, frames = sample(len(cameras), EACH), sample(keypoints.num_frames, POSES)
        seen = keypoints.confidence[chosen][:, frames] >= MIN_CONFIDENCE
        xy = np.where(seen[..., None], keypoints.xy[chosen][:, frames].astype(np.float64), np.nan)
        return cls(cameras.subset(chosen.tolist()), xy)

    def fit(self) -> EpipolarFit | None:
        """Fit the focal length factor and the rotations. Return None without common keypoints, or if it diverges."""
        precision = np.r_[SPREAD, np.full(3 * len(self.cameras), USUAL_SIGMA_SHARE)] ** -2.0
        x, share = np.zeros(len(precision)), min(1.0, BLOCKS / self.xy.shape[1])  # successive frames have equal errors
        for _ in range(MOST_ROUNDS):
            parts = list(self.distances(x))
            off = np.concatenate([part for _, part, *_ in parts])
            if not len(off):
                return None
            sigma = max(1.4826 * float(np.median(np.abs(off))), LEAST_NOISE)
            information, by_keypoint = np.diag(precision), np.zeros((self.xy.shape[2], len(x)))
            for columns, part, J, keypoint in parts:
                weighted = J * (share / sigma**2 / (1.0 + (part / (ROBUST_SIGMAS * sigma)) ** 2))[:, None]
                information[np.ix_(columns, columns)] += weighted.T @ J
                by_keypoint[:, columns] += np.eye(len(by_keypoint))[keypoint].T @ (weighted * part[:, None])
            step = -np.linalg.solve(information, by_keypoint.sum(axis=0) + x * precision)
            if abs(step[0]) < CONVERGED:
                # A detector's error of a keypoint is constant over frames, so keypoints are the independent units.
                covariance = np.linalg.inv(information)
                pulls = by_keypoint @ covariance[:, 0]
                variance = covariance[0, 0] + np.square(pulls - pulls.mean()).sum()
                return EpipolarFit(float(x[0]), float(np.sqrt(variance)), x[1:])
            x = x + step
            if abs(x[0]) > 2 * SPREAD:
                break
        return None

    def distances(self, x: np.ndarray) -> Iterator[tuple[list[int], np.ndarray, np.ndarray, np.ndarray]]:
        """Yield the epipolar distances of each pair of views, with derivatives.

        An item has the 7 columns of ``x`` that affect the pair, the (N,) distances in person sizes, their derivatives
        (N, 7) and their (N,) keypoints.

        Args:
            x: (1 + 3 C,) logarithm of the common focal length factor, then the rotations of the C cameras in radians.
        """
        rays, longer = (self._rays(log) for log in (x[0], x[0] + _STEP))
        turns, steps = x[1:].reshape(-1, 3), _STEP * np.eye(3)
        poses = [self._turned(c, turn) for c, turn in enumerate(turns)]
        moved = [[self._turned(c, turn + step) for step in steps] for c, turn in enumerate(turns)]
        for i, j in combinations(range(len(self.cameras)), 2):
            one, other = rays[i], rays[j]
            off = epipolar_distances(poses[i], poses[j], *one, *other)
            changed = [epipolar_distances(poses[i], poses[j], *longer[i], *longer[j])]
            changed += [epipolar_distances(pose, poses[j], *one, *other) for pose in moved[i]]
            changed += [epipolar_distances(poses[i], pose, *one, *other) for pose in moved[j]]
            columns = [0, *range(1 + 3 * i, 4 + 3 * i), *range(1 + 3 * j, 4 + 3 * j)]
            slopes = (np.stack(changed, axis=-1) - off[..., None]) / _STEP
            known = np.isfinite(slopes).all(-1) & self._off_epipoles[i, j]
            yield columns, off[known], slopes[known], np.nonzero(known)[1]

    @cached_property
    def _off_epipoles(self) -> np.ndarray:
        """(C, C, F, J) mask of keypoints, for each pair of views, that are far enough from the epipoles."""
        ways = unit(np.stack([rays for rays, _ in self._rays(0.0)]) @ self.cameras.R[:, None])
        base = unit(self.cameras.centres[:, None] - self.cameras.centres)
        along = np.square(np.einsum("cfjd,ced->cefj", ways, base))
        return np.fmax(along, np.swapaxes(along, 0, 1)) < 1 - SMALLEST_ANGLE_SIN2

    def _rays(self, log: float) -> list[tuple[np.ndarray, float]]:
        """Return each view's rays (F, J, 3) and person size, with focal lengths multiplied by ``exp(log)``."""
        K = self.cameras.K.copy()
        K[:, :2, :2] *= np.exp(log)
        n = undistort(replace(self.cameras, K=K), self.xy)
        sizes = np.nan_to_num(quantile(extent(n), 0.5, axis=1), nan=1.0)
        return list(zip(np.concatenate([n, np.ones_like(n[..., :1])], axis=-1), sizes.tolist(), strict=True))

    def _turned(self, camera: int, turn: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        R = exp_so3(turn)
        return R @ self.cameras.R[camera], R @ self.cameras.t[camera]


def report_lenses(cameras: Cameras, keypoints: Keypoints2D) -> tuple[Diagnostic, ...]:
    """Report focal lengths that are all too long or all too short. The calibration may have any length unit."""
    views = ComparedViews.of(cameras, keypoints)
    fit = None if views is None else views.fit()
    if views is None or fit is None or not fit.is_sure:
        return ()
    # One camera that follows a poster or a passer-by spoils all its pairs. Without it the factor has the other sign.
    everyone = range(len(views.cameras))
    for kept in ([c for c in everyone if c != left] for left in everyone if len(everyone) > LEAST_CAMERAS):
        part = ComparedViews(views.cameras.subset(kept), views.xy[kept]).fit()
        if part is None or part.log / fit.log <= 0:
            return ()
    way, percent = "short" if fit.log > 0 else "long", 100 * abs(np.exp(-fit.log) - 1)
    return (diagnostic("focal_lengths_off", cameras=cameras.names, percent=percent, way=way),)
