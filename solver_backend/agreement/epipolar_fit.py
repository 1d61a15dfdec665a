"""Fit focal lengths and small rotations of cameras to views of one person.

Distances of points from epipolar lines are minimised by Gauss-Newton with Cauchy weights. Every camera may rotate a
little, so that an inexact calibration is no evidence for another fault. A rotation changes the distances of the
camera's own pairs alone, so each pair adds to 7 rows of the normal equations.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np

from solver_backend.cameras.projection import distort_with_jacobian, is_distorted, undistort
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.lens import DEFAULT_MODEL
from solver_backend.geometry.rotations import exp_so3, left_jacobian_so3, skew
from solver_backend.geometry.small_matrices import dot, squared_length, sum_of_rows
from solver_backend.types import Cameras, Keypoints2D

FACTOR_SPREAD = 0.3  # Prior deviation of the logarithm of the factor.
TURN_SPREAD_RAD, LARGEST_TURN_RAD = 0.005, 0.015
"""Prior deviation of a calibrated camera's rotation, and largest rotation that a fault of lenses explains."""
OFF_PERSON = 0.006  # Least scatter of detections by the person's extent in the picture, for a person who stands still.
MOMENTS = 6
"""Independent moments of a take, chosen so that ten simulated takes scatter as their standard deviations state."""
LARGEST_LOG = 0.7
ROUNDS, CONVERGED = 40, 1e-3
"""Focal lengths and rotations are correlated: the last steps shrink by a quarter each, and 16 are usual."""
LEAST_CAMERAS = 3  # Two views agree by chance in too many ways.
MOST_CAMERAS, FRAMES = 8, 24  # Cameras and frames that are compared, of more.
SEEN = 0.3  # Least confidence of a keypoint.
_CAUCHY = 2.0  # Scale of the Cauchy weights, standard deviations.


@dataclass(frozen=True)
class EpipolarFit:
    """Best focal lengths and rotations of C cameras."""

    log: float  # Logarithm of the factor that focal lengths lack.
    sigma: float  # Its standard deviation.
    x: np.ndarray  # (1 + 3 C,) the same logarithm, and the cameras' rotations, rad.
    off: np.ndarray  # (N,) signed distances of points from epipolar lines, px.
    frames: int  # Number of frames.
    spread_px: float  # Standard deviation of the distances without outliers.

    @property
    def is_calibrated(self) -> bool:
        """Whether the rotations are those of calibrated cameras."""
        return bool(np.abs(self.x[1:]).max() < LARGEST_TURN_RAD)

    def misfit(self, spread_px: float) -> float:
        """Return twice the negative log posterior of independent moments, up to a constant.

        Args:
            spread_px: standard deviation of detections, the same for all compared fits.
        """
        lengths = _CAUCHY**2 * np.log1p((self.off / (_CAUCHY * spread_px)) ** 2)
        return float(_share(self.frames) * lengths.sum() + ((self.x / _spreads(len(self.x))) ** 2).sum())


@dataclass(frozen=True)
class ComparedViews:
    """Cameras and their detections of one person, for several checks of lenses."""

    cameras: Cameras
    xy: np.ndarray
    """(C, F, J, 2) px, NaN where unseen."""

    @classmethod
    def of(cls, cameras: Cameras, keypoints: Keypoints2D) -> ComparedViews | None:
        """Return the compared cameras and points, see ``compared_points``."""
        compared = compared_points(cameras, keypoints)
        return None if compared is None else cls(*compared)

    @cached_property
    def fit(self) -> EpipolarFit | None:
        """Fit with the calibrated lenses, see ``fit_epipolar``."""
        return fit_epipolar(self.cameras, self.xy)

    def without_one(self) -> list[ComparedViews]:
        """Return the views without each camera in turn, nothing for three views."""
        count = len(self.cameras)
        rest = [[c for c in range(count) if c != left] for left in range(count)] if count > LEAST_CAMERAS else []
        return [ComparedViews(self.cameras.subset(kept), self.xy[kept]) for kept in rest]


def compared_points(cameras: Cameras, keypoints: Keypoints2D) -> tuple[Cameras, np.ndarray] | None:
    """Return compared cameras and (C, F, J, 2) pixels, NaN where unseen. None if they are too few.

    Args:
        cameras: in any unit.
        keypoints: of one person in the same views.
    """
    if len(cameras) < LEAST_CAMERAS or not keypoints.num_frames:
        return None
    chosen = np.unique(np.linspace(0, len(cameras) - 1, MOST_CAMERAS).astype(int))
    frames = np.unique(np.linspace(0, keypoints.num_frames - 1, FRAMES).astype(int))
    seen = keypoints.confidence[chosen][:, frames] >= SEEN
    xy = np.where(seen[..., None], keypoints.xy[chosen][:, frames].astype(np.float64), np.nan)
    return cameras.subset(chosen.tolist()), xy


def fit_epipolar(cameras: Cameras, xy: np.ndarray) -> EpipolarFit | None:
    """Return the fit, None if too little is seen or it does not converge.

    Args:
        cameras: C cameras in any unit.
        xy: (C, F, J, 2) px of one person, NaN where unseen.
    """
    spreads, least = _spreads(1 + 3 * len(cameras)), OFF_PERSON * _extent(xy)
    x, pixels = np.zeros(len(spreads)), pixels_a_direction(cameras, xy)
    for _ in range(ROUNDS):
        parts = list(distances(cameras, xy, x, pixels))
        off = np.concatenate([part for _, part, _ in parts])
        if not len(off):
            return None
        sigma = max(1.4826 * float(np.median(np.abs(off))), least)
        information, gradient = np.diag(spreads**-2.0), x / spreads**2
        for columns, part, J in parts:
            weight = _share(xy.shape[1]) / sigma**2 / (1.0 + (part / (_CAUCHY * sigma)) ** 2)
            information[np.ix_(columns, columns)] += (J * weight[:, None]).T @ J
            gradient[columns] += J.T @ (weight * part)
        step = -np.linalg.solve(information, gradient)
        if abs(step[0]) < CONVERGED:
            covariance = np.linalg.inv(information)
            return EpipolarFit(float(x[0]), float(np.sqrt(covariance[0, 0])), x, off, xy.shape[1], sigma)
        x = x + step
        if abs(x[0]) > LARGEST_LOG:
            return None
    return None


def distances(
    cameras: Cameras, xy: np.ndarray, x: np.ndarray, pixels: np.ndarray
) -> Iterator[tuple[list[int], np.ndarray, np.ndarray]]:
    """Yield, for each pair of cameras, columns of ``x``, distances (N,) from epipolar lines in px, and (N, 7) slopes.

    With directions n and ``E = [t]x R``, ``r = f n_j' E n_i / |(E n_i)_xy, (E' n_j)_xy|``. A turn exp(d) of camera j
    makes E to ``exp(d) E``, one of camera i to ``E exp(-d)``.

    Args:
        cameras: C cameras.
        xy: (C, F, J, 2) px, NaN where unseen.
        x: (1 + 3 C,) logarithm of the focal lengths' factor; turns of the cameras, rad.
        pixels: (C, F, J) px that a point moves by if its direction does, see ``pixels_a_direction``.

    Reference: Hartley and Zisserman 2004, eq. 11.9 (Sampson's distance).
    """
    turns = x[1:].reshape(-1, 3)
    turn, by_turn = exp_so3(turns), left_jacobian_so3(turns)
    turned = replace(cameras, R=turn @ cameras.R, t=(turn @ cameras.t[..., None])[..., 0])
    seen, longer = _rays(cameras, xy, x[0])
    for i, j in combinations(range(len(cameras)), 2):
        both = np.isfinite(seen[i]).all(-1) & np.isfinite(seen[j]).all(-1)
        R = turned.R[j] @ turned.R[i].T
        E = skew(turned.t[j] - R @ turned.t[i]) @ R
        one, other = seen[i][both], seen[j][both]
        line, back = one @ E.T, other @ E
        slope = np.maximum(np.sqrt(squared_length(line[:, :2]) + squared_length(back[:, :2])), 1e-12)
        focal = 0.5 * np.exp(x[0]) * (pixels[i][both] + pixels[j][both])
        off = focal * dot(other, line) / slope
        # (N, 3, 7) changes of both lines, and (N, 7) of n_j' E n_i, by the logarithm, turns of i, turns of j
        of_i, of_j = skew(one) @ by_turn[i], skew(other) @ by_turn[j]
        line_by = np.concatenate([(longer[i][both] @ E.T)[..., None], E @ of_i, -skew(line) @ by_turn[j]], -1)
        back_by = np.concatenate([(longer[j][both] @ E)[..., None], -skew(back) @ by_turn[i], E.T @ of_j], -1)
        product_by = sum_of_rows(other[..., None] * line_by)
        product_by[:, 0] += dot(longer[j][both], line)
        slope_by = sum_of_rows(line[:, :2, None] * line_by[:, :2]) + sum_of_rows(back[:, :2, None] * back_by[:, :2])
        slope_by = slope_by / slope[:, None]
        J = (focal[:, None] * product_by - off[:, None] * slope_by) / slope[:, None]
        J[:, 0] += off
        yield [0, *(1 + 3 * i + n for n in range(3)), *(1 + 3 * j + n for n in range(3))], off, J


def _rays(cameras: Cameras, xy: np.ndarray, log: float) -> tuple[np.ndarray, np.ndarray]:
    """Return (C, F, J, 3) directions (x, y, 1) of pixels in lenses longer by a logarithm, and their slopes by it.

    Distortion D maps directions to ``m = (u - c) / f``, so ``dn = -D'^-1 m``.
    """
    K = cameras.K.copy()
    K[:, :2, :2] *= np.exp(log)
    n = undistort(replace(cameras, K=K), xy)
    (m, (xx, cross, yy)) = distort_with_jacobian(n, cameras.distortion, cameras.models)
    determinant = xx * yy - cross**2
    dx, dy = yy * m[..., 0] - cross * m[..., 1], xx * m[..., 1] - cross * m[..., 0]
    by_log = -np.stack([dx / determinant, dy / determinant, np.zeros_like(dx)], axis=-1)
    return np.concatenate([n, np.ones_like(n[..., :1])], axis=-1), by_log


def pixels_a_direction(cameras: Cameras, xy: np.ndarray) -> np.ndarray:
    """Return (C, F, J) px per unit of a point's direction (x, y, 1) in the calibrated lenses.

    Distorting lenses have another scale at their edge, and detectors err in pixels.
    """
    n = undistort(cameras, xy)
    _, (xx, cross, yy) = distort_with_jacobian(n, cameras.distortion, cameras.models)
    focal = 0.5 * np.trace(cameras.K[:, :2, :2], axis1=1, axis2=2)
    return focal[:, None, None] * np.sqrt(np.maximum(xx * yy - cross**2, 0.0))


def _spreads(count: int) -> np.ndarray:
    return np.r_[FACTOR_SPREAD, np.full(count - 1, TURN_SPREAD_RAD)]


def _share(frames: int) -> float:
    """Return the weight of a frame. Neighbouring frames show the same."""
    return min(1.0, MOMENTS / frames)


def _extent(xy: np.ndarray) -> float:
    """Return the median diagonal of the person in a picture, px. 0 if no person is seen."""
    some = np.isfinite(xy).all(-1).any(-1)
    if not some.any():
        return 0.0
    people = xy[some]
    return float(np.median(np.linalg.norm(np.nanmax(people, axis=1) - np.nanmin(people, axis=1), axis=-1)))


OFF = 0.05  # Least logarithm of a reported factor.
SIGMAS = 3.5
"""Its least number of standard deviations. Right lenses reach 2.5 in ten simulated takes, the demo and recorded takes.
Lenses that are 10 % too long reach 3.9 in nine of ten simulated takes."""
LEFT_SHARE = 0.3
"""Least share of the logarithm without any one camera. In the demo, lenses that are all 10 to 25 % off leave 0.47 to
1.6. Without a camera that detects a poster for a third of the take, -0.02 are left."""


def report_focal_lengths(
    cameras: Cameras, keypoints: Keypoints2D, views: ComparedViews | None = None
) -> tuple[Diagnostic, ...]:
    """Warn of focal lengths that are all too long or too short, if the views show it clearly.

    Args:
        cameras: C cameras in any unit.
        keypoints: of one person in the same views.
        views: what is compared of both, where it is known.
    """
    views = views or ComparedViews.of(cameras, keypoints)
    fit = None if views is None else views.fit
    if views is None or fit is None or not fit.is_calibrated or abs(fit.log) < max(OFF, SIGMAS * fit.sigma):
        return ()
    # One camera that saw somebody else spoils all its pairs.
    rest = [part.fit for part in views.without_one()]
    if not all(part is not None and part.log / fit.log > LEFT_SHARE for part in rest):
        return ()
    way, percent = "short" if fit.log > 0 else "long", 100 * abs(np.exp(-fit.log) - 1)
    return (diagnostic("focal_lengths_off", cameras=cameras.names, percent=percent, way=way),)


GAIN = 8.0
"""Least doubled log-likelihood ratio of views without distortion. Five recorded takes and the demo with right lenses of
k1 from -0.32 to 0.2 reach 4.7. Undistorted pixels reach 9 to 33 if a person walks to an edge with 9 px of distortion.
1 to 2 px in the middle cannot be detected."""
UNDISTORTED_LEFT_SHARE = 0.1
"""Least mean share of the gain without one camera. Undistorted pixels leave 0.22 to 0.4 (four cameras), a camera that
follows a passer-by -0.03."""


def report_undistorted(
    cameras: Cameras, keypoints: Keypoints2D, views: ComparedViews | None = None
) -> tuple[Diagnostic, ...]:
    """Warn of pixels that are already undistorted, if the views show it clearly.

    Args:
        cameras: C cameras in any unit.
        keypoints: of one person in the same views.
        views: what is compared of both, where it is known.
    """
    if not is_distorted(cameras.distortion, cameras.models):
        return ()
    views = views or ComparedViews.of(cameras, keypoints)
    if views is None:
        return ()
    gain, rest = _gain(views), views.without_one()
    if gain < GAIN or (rest and np.mean([_gain(part) for part in rest]) < UNDISTORTED_LEFT_SHARE * gain):
        return ()
    return (diagnostic("pixels_undistorted", cameras=cameras.names),)


def _gain(views: ComparedViews) -> float:
    """Return the doubled log-likelihood ratio of the views without distortion, 0 if it is unknown."""
    chosen = views.cameras
    without = replace(chosen, distortion=np.zeros_like(chosen.distortion), models=(DEFAULT_MODEL,))
    fits = views.fit, fit_epipolar(without, views.xy)
    if fits[0] is None or fits[1] is None or not fits[1].is_calibrated:
        return 0.0
    spread = max(fits[0].spread_px, fits[1].spread_px)
    return fits[0].misfit(spread) - fits[1].misfit(spread)
