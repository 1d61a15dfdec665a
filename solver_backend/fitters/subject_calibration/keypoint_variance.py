"""How reliable each keypoint is in each view, learned from what the body leaves unexplained there."""

from __future__ import annotations

import numpy as np
from array_api_compat import array_namespace

from solver_backend.fitters.model.posed_frames import PosedFrames
from solver_backend.fitters.model.subject import Subject, pose
from solver_backend.fitters.problem import Problem
from solver_backend.fitters.settings import SolveSettings
from solver_backend.geometry.arrays import Array
from solver_backend.residuals.point_term import DataTerm

PRIOR_FRAMES = 60.0
"""How many frames' worth of evidence there is that all views are alike; errors of neighbouring frames are."""
RANGE = (0.2, 5.0)
"""Least and largest variance of one view's keypoint, as a share of the keypoint's mean over the views."""


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
    relative to their keypoint's mean: how noisy a keypoint is altogether is known from what the views disagree on, and
    residuals of a body that does not follow a bent toe or a fast limb yet would pass for more of it, and keep it so.
    Points that are measured once teach nothing.

    Args:
        subject: the person.
        frames: poses of the sample.
        term: data of all frames.
        scale: detections beyond this many standard deviations are left out.
        sample: frame numbers of the sample.
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
