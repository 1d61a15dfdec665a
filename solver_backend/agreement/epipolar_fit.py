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
    POSES,
    epipolar_distances,
)
from solver_backend.agreement.hypotheses import CONVERGED, SPREAD
from solver_backend.agreement.person_tracks import SMALLEST_ANGLE_SIN2
from solver_backend.agreement.reading import MIN_CONFIDENCE, extent
from solver_backend.agreement.synchronisation import USUAL_SIGMA_SHARE
from solver_backend.cameras.projection import distorted, undistort
from solver_backend.cameras.robust_triangulation import INLIER_SIGMAS, ROBUST_SIGMAS
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.geometry.arrays import quantile
from solver_backend.geometry.rotations import exp_so3
from solver_backend.types import Cameras, Keypoints2D

_STEP = 1e-6  # Step of numerical derivatives.
OFF = 0.05  # Smallest logarithm of a reported factor, which must also exceed ``INLIER_SIGMAS`` deviations.


@dataclass(frozen=True)
class EpipolarFit:
    """Best focal lengths and rotations of C cameras."""

    log: float  # Logarithm of the factor missing in the focal lengths.
    sigma: float  # Its standard deviation.
    turns: np.ndarray  # (3 C,) rotations of the cameras in radians.

    @property
    def is_sure(self) -> bool:
        """True if the factor is significant, and the rotations are plausible for calibrated cameras."""
        is_calibrated = np.abs(self.turns).max() < 3 * USUAL_SIGMA_SHARE
        return bool(is_calibrated and abs(self.log) >= max(OFF, INLIER_SIGMAS * self.sigma))


@dataclass(frozen=True)
class ComparedViews:
    """Cameras and their detections of one person."""

    cameras: Cameras
    xy: np.ndarray  # (C, F, J, 2) px, NaN where unseen.

    @classmethod
    def of(cls, cameras: Cameras, keypoints: Keypoints2D) -> ComparedViews | None:
        """Return up to ``EACH`` views in ``POSES`` frames, or None if there are too few."""
        if len(cameras) < LEAST_CAMERAS or not keypoints.num_frames:
            return None
        chosen = np.unique(np.linspace(0, len(cameras) - 1, EACH).astype(int))
        frames = np.unique(np.linspace(0, keypoints.num_frames - 1, POSES).astype(int))
        seen = keypoints.confidence[chosen][:, frames] >= MIN_CONFIDENCE
        xy = np.where(seen[..., None], keypoints.xy[chosen][:, frames].astype(np.float64), np.nan)
        return cls(cameras.subset(chosen.tolist()), xy)

    def fit(self) -> EpipolarFit | None:
        """Fit the views. Return None if too little is visible or the fit does not converge."""
        precision = np.r_[SPREAD, np.full(3 * len(self.cameras), USUAL_SIGMA_SHARE)] ** -2.0
        least = LEAST_NOISE * float(np.nan_to_num(quantile(extent(self.xy), 0.5, (0, 1))))
        x, share = np.zeros(len(precision)), min(1.0, BLOCKS / self.xy.shape[1])  # successive frames have equal errors
        for _ in range(MOST_ROUNDS):
            parts = list(self.distances(x))
            off = np.concatenate([part for _, part, *_ in parts])
            if not len(off):
                return None
            sigma = max(1.4826 * float(np.median(np.abs(off))), least)
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
        """Yield columns, epipolar distances in px, (N, 7) derivatives and keypoints of view pairs.

        Args:
            x: (1 + 3 C,) logarithm of the focal lengths' factor, then rotations of the cameras in radians.
        """
        rays, longer = (_rays(self.cameras, self.xy, log) for log in (x[0], x[0] + _STEP))
        turns, steps = x[1:].reshape(-1, 3), _STEP * np.eye(3)
        poses = [self._turned(c, turn) for c, turn in enumerate(turns)]
        moved = [[self._turned(c, turn + step) for step in steps] for c, turn in enumerate(turns)]
        pixels = self._pixels_per_direction
        for i, j in combinations(range(len(self.cameras)), 2):
            both = np.isfinite(rays[i]).all(-1) & np.isfinite(rays[j]).all(-1) & self._off_epipoles[i, j]
            focal = 0.5 * np.exp(x[0]) * (pixels[i][both] + pixels[j][both])
            a, b = rays[i][both], rays[j][both]
            off = focal * epipolar_distances(poses[i], poses[j], a, 1.0, b, 1.0)
            by_log = epipolar_distances(poses[i], poses[j], longer[i][both], 1.0, longer[j][both], 1.0)
            changed = [np.exp(_STEP) * focal * by_log]
            changed += [focal * epipolar_distances(pose, poses[j], a, 1.0, b, 1.0) for pose in moved[i]]
            changed += [focal * epipolar_distances(poses[i], pose, a, 1.0, b, 1.0) for pose in moved[j]]
            columns = [0, *range(1 + 3 * i, 4 + 3 * i), *range(1 + 3 * j, 4 + 3 * j)]
            slopes = (np.stack(changed, axis=-1) - off[:, None]) / _STEP
            known = np.isfinite(off) & np.isfinite(slopes).all(-1)  # cameras at one position have no epipolar lines
            yield columns, off[known], slopes[known], np.nonzero(both)[1][known]

    @cached_property
    def _off_epipoles(self) -> np.ndarray:
        """(C, C, F, J) mask of points with rays at a sufficient angle to the line through two cameras.

        Near an epipole, every point is near its epipolar line for any lens. This affects opposite cameras of a ring.
        """
        ways = _rays(self.cameras, self.xy, 0.0) @ self.cameras.R[:, None]
        ways = ways / np.linalg.norm(ways, axis=-1, keepdims=True)
        base = self.cameras.centres[:, None] - self.cameras.centres
        base = base / np.maximum(np.linalg.norm(base, axis=-1, keepdims=True), 1e-12)
        along = np.square(np.einsum("cfjd,ced->cefj", ways, base))
        return np.fmax(along, np.swapaxes(along, 0, 1)) < 1 - SMALLEST_ANGLE_SIN2

    def _turned(self, camera: int, turn: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        R = exp_so3(turn)
        return R @ self.cameras.R[camera], R @ self.cameras.t[camera]

    @cached_property
    def _pixels_per_direction(self) -> np.ndarray:
        """(C, F, J) pixels per unit of direction at each point, which depend on the lens."""
        n, cameras = undistort(self.cameras, self.xy), self.cameras
        _, _, (xx, cross, yy) = distorted(n[..., 0], n[..., 1], cameras.distortion, cameras.models)
        focal = 0.5 * np.trace(cameras.K[:, :2, :2], axis1=1, axis2=2)
        return focal[:, None, None] * np.sqrt(np.maximum(xx * yy - cross**2, 0.0))


def report_lenses(cameras: Cameras, keypoints: Keypoints2D) -> tuple[Diagnostic, ...]:
    """Report focal lengths that are all too long or too short. The cameras may have any unit."""
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


def _rays(cameras: Cameras, xy: np.ndarray, log: float) -> np.ndarray:
    """Return (C, F, J, 3) directions (x, y, 1) of pixels, with log focal lengths increased by ``log``."""
    K = cameras.K.copy()
    K[:, :2, :2] *= np.exp(log)
    n = undistort(replace(cameras, K=K), xy)
    return np.concatenate([n, np.ones_like(n[..., :1])], axis=-1)
