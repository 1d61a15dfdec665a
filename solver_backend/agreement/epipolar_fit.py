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

from solver_backend.agreement.evidence import EACH, LEAST_CAMERAS, MOST_ROUNDS, epipolar_distances
from solver_backend.agreement.reading import extent
from solver_backend.cameras.projection import distorted, is_distorted, undistort
from solver_backend.cameras.robust_triangulation import INLIER_SIGMAS
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.lens import DEFAULT_MODEL
from solver_backend.geometry.arrays import quantile
from solver_backend.geometry.rotations import exp_so3
from solver_backend.types import Cameras, Keypoints2D

FACTOR_SPREAD, TURN_SPREAD_RAD = 0.3, 0.005  # Prior deviations of the factor's logarithm and of a camera's rotation.
OFF_PERSON = 0.006  # Smallest deviation of detections relative to the person's image size, for a still person.
MOMENTS = 6
"""Number of independent frames in a take, chosen so that the estimated deviations match the scatter of ten takes."""
CONVERGED = 1e-3
"""Largest final step. Focal lengths and rotations are correlated, so a step removes only a quarter of the error.
Usually 16 steps are needed.
"""
FRAMES = 24  # Frames to sample.
EPIPOLE_ANGLE = np.radians(20.0)  # Smallest angle between a ray and the line through two cameras.
SEEN = 0.3  # Smallest confidence of a keypoint. Larger ones bring recorded takes closer to their true lenses.
OFF = 0.05
"""Smallest logarithm of a reported factor, which must also exceed ``INLIER_SIGMAS`` deviations. Correct lenses reach
2.5 in ten simulated takes, the demo and recorded takes. Lenses 10 % too long reach 3.9 in nine of ten."""
GAIN = 8.0
"""Smallest doubled log-likelihood ratio of views without distortion. Five recorded takes and the demo with correct
lenses (k1 from -0.32 to 0.2) reach 4.7. Undistorted pixels reach 9 to 33 if a person walks to an image edge with 9 px
of distortion. 1 to 2 px in the image centre cannot be detected."""
LEFT_SHARE = 0.3, 0.1
"""Smallest share of the factor that remains without any one camera, and mean share of the gain. If cameras follow a
poster or a passer-by, the remaining share is negative. For wrong lenses it is at least 0.22."""
USUAL_K1 = -0.3, -0.15, 0.15  # Distortion coefficients to try if the calibration has none.
_CAUCHY, _STEP = 2.0, 1e-6  # Scale of the weights in standard deviations, and step of numerical derivatives.


@dataclass(frozen=True)
class EpipolarFit:
    """Best focal lengths and rotations of C cameras."""

    log: float  # Logarithm of the factor missing in the focal lengths.
    sigma: float  # Its standard deviation.
    x: np.ndarray  # (1 + 3 C,) the same logarithm, then the cameras' rotations in radians.
    off: np.ndarray  # (N,) signed distances of points from epipolar lines, px.
    frames: int  # Number of frames.
    spread_px: float  # Standard deviation of the distances without outliers.

    @property
    def is_calibrated(self) -> bool:
        """True if the rotations are plausible for calibrated cameras."""
        return bool(np.abs(self.x[1:]).max() < 3 * TURN_SPREAD_RAD)

    def misfit(self, spread_px: float) -> float:
        """Return twice the negative log posterior of independent frames, up to a constant.

        Args:
            spread_px: standard deviation of detections, the same for all compared fits.
        """
        lengths = _CAUCHY**2 * np.log1p((self.off / (_CAUCHY * spread_px)) ** 2)
        return float(_share(self.frames) * lengths.sum() + ((self.x / _spreads(len(self.x))) ** 2).sum())


@dataclass(frozen=True)
class ComparedViews:
    """Cameras and their detections of one person."""

    cameras: Cameras
    xy: np.ndarray  # (C, F, J, 2) px, NaN where unseen.

    @classmethod
    def of(cls, cameras: Cameras, keypoints: Keypoints2D) -> ComparedViews | None:
        """Return the views of up to ``EACH`` cameras in ``FRAMES`` frames, or None for too few."""
        if len(cameras) < LEAST_CAMERAS or not keypoints.num_frames:
            return None
        chosen = np.unique(np.linspace(0, len(cameras) - 1, EACH).astype(int))
        frames = np.unique(np.linspace(0, keypoints.num_frames - 1, FRAMES).astype(int))
        seen = keypoints.confidence[chosen][:, frames] >= SEEN
        xy = np.where(seen[..., None], keypoints.xy[chosen][:, frames].astype(np.float64), np.nan)
        return cls(cameras.subset(chosen.tolist()), xy)

    @cached_property
    def fit(self) -> EpipolarFit | None:
        """Fit the views. Return None if too little is visible or the fit does not converge."""
        spreads = _spreads(1 + 3 * len(self.cameras))
        least = OFF_PERSON * float(np.nan_to_num(quantile(extent(self.xy), 0.5, (0, 1))))
        x = np.zeros(len(spreads))
        for _ in range(MOST_ROUNDS):
            parts = list(self.distances(x))
            off = np.concatenate([part for _, part, *_ in parts])
            if not len(off):
                return None
            sigma = max(1.4826 * float(np.median(np.abs(off))), least)
            information, by_keypoint = np.diag(spreads**-2.0), np.zeros((self.xy.shape[2], len(x)))
            for columns, part, J, keypoint in parts:
                weight = _share(self.xy.shape[1]) / sigma**2 / (1.0 + (part / (_CAUCHY * sigma)) ** 2)
                information[np.ix_(columns, columns)] += (J * weight[:, None]).T @ J
                for k in range(len(by_keypoint)):
                    by_keypoint[k, columns] += J[keypoint == k].T @ (weight * part)[keypoint == k]
            step = -np.linalg.solve(information, by_keypoint.sum(axis=0) + x / spreads**2)
            if abs(step[0]) < CONVERGED:
                # A detector's error of a keypoint is constant over frames, so keypoints are the independent units.
                pulls = by_keypoint @ np.linalg.inv(information)[:, 0]
                covariance = np.linalg.inv(information) + np.square(pulls - pulls.mean()).sum()
                return EpipolarFit(float(x[0]), float(np.sqrt(covariance[0, 0])), x, off, self.xy.shape[1], sigma)
            x = x + step
            if abs(x[0]) > 2 * FACTOR_SPREAD:
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
        along = np.abs(np.einsum("cfjd,ced->cefj", ways, base))
        return np.fmax(along, np.swapaxes(along, 0, 1)) < np.cos(EPIPOLE_ANGLE)

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

    def with_k1(self, k1: float) -> ComparedViews:
        """Return the same pixels for lenses with one distortion coefficient, 0 for none."""
        lens = np.zeros_like(self.cameras.distortion)
        lens[:, 0] = k1
        return ComparedViews(replace(self.cameras, distortion=lens, models=(DEFAULT_MODEL,)), self.xy)

    def without_one(self) -> list[ComparedViews]:
        """Return the views without each camera in turn, or an empty list for three views."""
        count = len(self.cameras)
        rest = [[c for c in range(count) if c != left] for left in range(count)] if count > LEAST_CAMERAS else []
        return [ComparedViews(self.cameras.subset(kept), self.xy[kept]) for kept in rest]

    def gain(self, k1: float) -> float:
        """Return the doubled log-likelihood ratio for another distortion, 0 if unknown."""
        now, then = self.fit, self.with_k1(k1).fit
        if now is None or then is None or not then.is_calibrated:
            return 0.0
        spread = max(now.spread_px, then.spread_px)
        return now.misfit(spread) - then.misfit(spread)


def report_lenses(cameras: Cameras, keypoints: Keypoints2D) -> tuple[Diagnostic, ...]:
    """Report focal lengths that are all too long or too short, and undistorted pixels.

    Args:
        cameras: C cameras in any unit.
    """
    views, found = ComparedViews.of(cameras, keypoints), list[Diagnostic]()
    if views is None:
        return ()
    fit, rest = views.fit, views.without_one()  # one camera that saw another person spoils all its pairs
    sure = fit is not None and fit.is_calibrated and abs(fit.log) >= max(OFF, INLIER_SIGMAS * fit.sigma)
    if fit is not None and sure and all(part.fit and part.fit.log / fit.log > LEFT_SHARE[0] for part in rest):
        way, percent = "short" if fit.log > 0 else "long", 100 * abs(np.exp(-fit.log) - 1)
        found.append(diagnostic("focal_lengths_off", cameras=cameras.names, percent=percent, way=way))
    distorted = is_distorted(cameras.distortion, cameras.models)
    gains = {k1: views.gain(k1) for k1 in ((0.0,) if distorted else USUAL_K1)}
    k1 = max(gains, key=lambda k1: gains[k1])
    if gains[k1] >= GAIN and (not rest or np.mean([p.gain(k1) for p in rest]) >= LEFT_SHARE[1] * gains[k1]):
        kind = "removed" if distorted else "absent"
        found.append(diagnostic("pixels_undistorted", cameras=cameras.names, kind=kind, k1=k1))
    return tuple(found)


def _rays(cameras: Cameras, xy: np.ndarray, log: float) -> np.ndarray:
    """Return (C, F, J, 3) directions (x, y, 1) of pixels, with log focal lengths increased by ``log``."""
    K = cameras.K.copy()
    K[:, :2, :2] *= np.exp(log)
    n = undistort(replace(cameras, K=K), xy)
    return np.concatenate([n, np.ones_like(n[..., :1])], axis=-1)


def _spreads(count: int) -> np.ndarray:
    return np.r_[FACTOR_SPREAD, np.full(count - 1, TURN_SPREAD_RAD)]


def _share(frames: int) -> float:
    """Return the weight of a frame, as neighbouring frames contain the same information."""
    return min(1.0, MOMENTS / frames)
