"""Planted points of the feet, read from a first solution."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain

import numpy as np

from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.exchange.stands import SPEED_M_S, stands, steps
from solver_backend.fitters.model.subject import PosedFrames, Subject, pose
from solver_backend.fitters.problem import Problem
from solver_backend.geometry.arrays import Array, array_namespace, constant, to_numpy
from solver_backend.residuals.positions import SIGMA_M, PositionTerm, foot_contact_term
from solver_backend.residuals.terms import DataTerm

ALONG_SIGHT = 3.0
"""Factor of the speed limit along the line of sight of a single camera, which sees no depth. On 48 filmed takes of
subjects 08, 60 and of some that the lifter is trained on, feet skate by 0.011 cm a frame instead of 0.012 and joints
are 0.1 mm nearer, with 2 as with 4. On the benchmark's own takes a foot goes deeper below the floor with 4."""
SLOW_SHARE = 0.2  # A foot before one camera may seem to stand as fast as this share of its fast speeds.
_FOOT_POINTS = ("big_toe", "small_toe", "heel", "HEE", "TOE", "MT1", "MT5", "HAL")
"""A detector's keypoints and places of markers, without their side."""
_SOLE_POINTS = ("sole_heel", "sole_toe", "sole_inner", "sole_outer")  # Points of the skin, see ``with_soles``.
_SIDES = (("left_", "L"), ("right_", "R"))


@dataclass(frozen=True)
class Contacts:
    """Planted points of the feet."""

    planted: np.ndarray  # (F, L) bool.
    anchors: np.ndarray  # (F, L, 3) metres: the mean position of each stand, 0 elsewhere.

    def feet(self, names: tuple[str, ...]) -> np.ndarray | None:
        """Return (F, 2) bool: a point of the left and of the right foot is planted, None where no point is a foot's."""
        feet = _foot_columns(names)
        if not feet:
            return None
        sides = [[k for k in feet if names[k].startswith(side)] for side in _SIDES]
        return np.stack([self.planted[:, columns].any(axis=1) for columns in sides], axis=1)

    def term(self, like: Array, firmness: float = 1.0) -> PositionTerm:
        """Return the term that draws the planted points to their anchors; firmness divides its deviation."""
        return foot_contact_term(self.planted, self.anchors, like, SIGMA_M / firmness)


def find_contacts(
    points: np.ndarray,
    names: tuple[str, ...],
    fps: float,
    fixed: np.ndarray | None = None,
    sight: np.ndarray | None = None,
    heights: np.ndarray | None = None,
) -> Contacts:
    """Find the frame ranges in which points of the feet are slow and low.

    Args:
        points: (F, L, 3) solved positions, metres, Z up.
        fixed: (F,) bool, frames that will not move: a stand that includes some is where they are.
        sight: (F, 3) unit direction of the one camera that sees the person, None where several do.
        heights: (L,) of the points of a standing foot above a known floor, NaN for other points; None if the floor is
            not known. Anchors are at these heights.
    """
    fixed = np.zeros(len(points), dtype=bool) if fixed is None else fixed
    columns = _foot_columns(names) if heights is None else [int(k) for k in np.flatnonzero(np.isfinite(heights))]
    planted, anchors = np.zeros(points.shape[:2], dtype=bool), np.zeros(points.shape)
    if len(points) < 3 or not columns:
        return Contacts(planted, anchors)
    feet = points[:, columns]
    way, seconds = steps(feet, fps)
    if sight is not None:
        along = np.einsum("fka,fa->fk", way, sight)[..., None] * sight[:, None]
        way = way - (1.0 - 1.0 / ALONG_SIGHT) * along
    speed = np.linalg.norm(way, axis=-1) / seconds
    if sight is not None:
        speed *= min(1.0, SPEED_M_S / max(SLOW_SHARE * float(np.nanpercentile(speed, 90.0)), 1e-9))
    for place, runs in enumerate(stands(feet[..., 2], speed, fps)):
        for first, stop in runs:
            planted[first:stop, columns[place]] = True
            sure = fixed[first:stop] if fixed[first:stop].any() else slice(None)
            anchors[first:stop, columns[place]] = feet[first:stop, place][sure].mean(axis=0)
    if heights is not None:
        anchors[..., 2] = np.where(planted, np.nan_to_num(heights), 0.0)
    return Contacts(planted, anchors)


def _foot_columns(names: tuple[str, ...]) -> list[int]:
    feet = {side + point for side in chain(*_SIDES) for point in (*_FOOT_POINTS, *_SOLE_POINTS)}
    return [k for k, name in enumerate(names) if name in feet]


PRIOR_FRAMES = 60.0  # Weight of equal views in frames: errors of neighbouring frames are alike.
RANGE = (0.2, 5.0)  # Limits of the variance of one view's keypoint, by the keypoint's mean over the views.


def with_learned_noise(problem: Problem, subject: Subject, sample: PosedFrames, settings: SolveSettings) -> DataTerm:
    """Return the data; if asked, with the variances of each view's points learned from the sample's poses."""
    data = problem.measurements.term
    if not settings.learn_noise:
        return data
    return reweighted(subject, sample, data, settings.robust_scale, problem.sample)


def reweighted(subject: Subject, frames: PosedFrames, term: DataTerm, scale: float, sample: np.ndarray) -> DataTerm:
    """Return the term with the variance of every view's keypoints learned from the residuals of a solution.

    ``v_cl = (Σ_f |r|²/d + n v_l) / (Σ_f (1 - h) + n)`` over the inliers, in units of the variance assumed so far: the
    restricted maximum of the log-variance's likelihood (thesis eqs. 5.2, 5.3) under an inverse-gamma prior. h is the
    share of a view's own error that the point takes over, ``w J S⁻¹ Jᵀ`` with ``S = Σ_c w Jᵀ J``. Variances are
    relative to their keypoint's mean: the views' disagreement determines a keypoint's overall noise, and residuals of a
    body that does not follow a bent toe or a fast limb yet would pass for more of it, and keep it so. Points that are
    measured once teach nothing.

    Args:
        term: data of all frames.
        scale: detections beyond this many standard deviations are excluded.
    """
    return reweighted_by_points(pose(subject, frames).points, term.select(sample), term, scale)


def reweighted_by_points(points: Array, part: DataTerm, term: DataTerm, scale: float) -> DataTerm:
    """Return ``reweighted`` of a sample's points (S, L, 3), with the part of the term that is theirs."""
    xp = array_namespace(points)
    found = part.residuals(points)
    inlier = found.inliers(scale)
    used = xp.astype(inlier, found.squared.dtype)
    square = used * found.squared / found.error.shape[-1]
    free = used * (1.0 - part.leverage(points, inlier))
    if not bool(xp.any(free > 0)):
        return term
    sums, freedoms = xp.sum(square, axis=1), xp.sum(free, axis=1)
    mean = xp.sum(sums, axis=0) / xp.clip(xp.sum(freedoms, axis=0), 1.0, None)
    mean = xp.clip(mean, 0.05, None)
    variance = (sums + PRIOR_FRAMES * mean) / (freedoms + PRIOR_FRAMES)
    return term.rescaled(xp.clip(variance / mean, *RANGE)[:, None])


WINDOW_S = 0.5  # Length of a window: errors of markers and of networks last about as long.
TAKE_FRAMES, WINDOW_FRAMES = 20.0, 10.0
"""Weights, in frames, of the mean landmark, and of a landmark's mean over the take."""
LANDMARK_RANGE = (0.2, 25.0)  # Limits of the variance by the first.


def with_window_variances(
    term: DataTerm, points: Array, fps: float, scale: float, dof: float, looked_at: np.ndarray | None = None
) -> DataTerm:
    """Return the term with a variance for every landmark and window of ``WINDOW_S``.

    ``v_lw = (Σ_{f in w} |r_lf|²/3 + n v_l) / (Σ_{f in w} (1 - h) + n)`` over the inliers, in units of the variance
    assumed so far, and v_l from all of the take about the mean landmark in the same way: the maximum of the
    log-variances' likelihood (thesis eqs. 5.2, 5.3) in closed form, under inverse-gamma priors. h is the share of a
    landmark's error that the body takes over: unknowns by measured coordinates. A level below the assumed one is not
    used, as residuals of a solution are smooth in any case.

    Args:
        term: landmarks measured once, all F frames.
        points: (F, L, 3) landmarks of a solution.
        scale: landmarks beyond this many standard deviations are excluded.
        dof: unknowns of a solution for each frame.
        looked_at: (T,) bool of all frames of the term: those of the points, None for all. A window without any has the
            landmark's mean.

    Reference: Kendall and Gal 2017, eq. 8, whose minimum by a variance this is.
    """
    looked_at = np.ones(len(points), dtype=bool) if looked_at is None else looked_at
    found = term.select(np.flatnonzero(looked_at)).residuals(points)
    inlier, squared = to_numpy(found.inliers(scale)).sum(0), to_numpy(found.squared).sum(0)
    used = inlier.astype(np.float64)
    per_frame = 3.0 * np.maximum(used.sum(-1, keepdims=True), 1.0)
    free = used * (1.0 - np.minimum(dof / per_frame, 0.5))
    square = used * squared / 3.0
    mean = square.sum() / max(free.sum(), 1.0)
    by_landmark = (square.sum(0) + TAKE_FRAMES * mean) / (free.sum(0) + TAKE_FRAMES)
    window = (np.arange(len(looked_at)) / max(1.0, WINDOW_S * fps)).astype(int)
    sums, freedoms = np.zeros((2, window[-1] + 1, square.shape[1]))
    for total, values in ((sums, square), (freedoms, free)):
        np.add.at(total, window[looked_at], values)
    variance = (sums + WINDOW_FRAMES * by_landmark) / (freedoms + WINDOW_FRAMES)
    level = min(float(np.median(by_landmark)), 1.0)
    return term.rescaled(constant(np.clip(variance / max(level, 1e-3), *LANDMARK_RANGE)[window][None], points))
