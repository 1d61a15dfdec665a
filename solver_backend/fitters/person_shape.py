"""Estimate the constants of a take: body shape, landmark bias, noise and planted feet."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from itertools import chain

import numpy as np

from solver_backend.body.state_layout import RESIDUAL, UNCOVERED, StateLayout
from solver_backend.exchange.progress import Progress
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.exchange.stands import SPEED_M_S, stands, steps
from solver_backend.fitters.model.subject import (
    FrameObjective,
    FrameStates,
    PosedFrames,
    Subject,
    d_pose_d_key,
    pose,
    state_layout,
)
from solver_backend.fitters.problem import Problem
from solver_backend.fitters.single_frame import fit_frames, fit_to_points, lifted_betas, posed, sample_frames
from solver_backend.geometry.arrays import Array, array_namespace, constant, identity, to_numpy, zeros
from solver_backend.priors.base import PosePrior
from solver_backend.residuals.positions import SIGMA_M, PositionTerm, foot_contact_term
from solver_backend.residuals.terms import DataTerm, graduated_scales
from solver_backend.solver.levenberg_marquardt import Arrowhead, DenseBlocks, LMSettings, levenberg_marquardt

FIXED = 1e12  # Precision of unknowns that are kept.
LIMBS_SIGMA, STATURE_SIGMAS = 0.015, 2.0
"""Relative standard deviation of a stature estimated from limbs, and number of deviations at which it contradicts a
given stature (1.8 % on a take of 1.80 m)."""


@dataclass(frozen=True)
class ShapePrior:
    """Prior for body shape and landmark offsets. Shape coefficients have unit variance."""

    offset_sigma_m: float | np.ndarray = 0.02  # Deviation of a detector's points from landmarks, (L,) or one for all.
    evidence: float = 0.2  # Share of new information per frame, because detector noise is correlated in time.
    free_betas: bool = True  # False keeps a known shape.
    free_offsets: bool = True  # False keeps the landmarks unchanged.
    stature_m: float = 0.0  # Stature in metres that a free shape keeps unless the limbs contradict it, 0 if unknown.


@dataclass(frozen=True)
class PersonState:
    """Person, poses in F frames, and the layout of one frame's unknowns."""

    subject: Subject
    frames: FrameStates
    layout: StateLayout

    def retract(self, step: Array) -> PersonState:
        """Move the state by a (1, 10 + 3 L + n F) step: first shape and offsets, then the frames."""
        shared = 10 + 3 * len(self.subject.landmarks)
        by_frame = array_namespace(step).reshape(step[0, shared:], (len(self.frames.z), -1))
        return replace(
            self, subject=moved(self.subject, step[0, :shared]), frames=self.frames.retract(by_frame, self.layout)
        )


def fit_shape(
    subject: Subject,
    prior: PosePrior,
    objective: FrameObjective,
    start: FrameStates,
    scales: tuple[float, ...],
    settings: LMSettings,
    shape_prior: ShapePrior = ShapePrior(),
) -> tuple[Subject, FrameStates]:
    """Fit body shape, landmark offsets and sample poses together, using arrowhead equations.

    ``subject`` contains the initial shape and offsets. ``scales`` are decreasing Geman-McClure scales.
    """
    state = PersonState(subject, start, state_layout(prior).without(UNCOVERED, RESIDUAL))
    precision, mean = _prior_precision(subject, shape_prior), _prior_mean(subject, shape_prior)
    for scale in scales:
        linearise = partial(_arrowhead, prior, objective, scale, precision, mean)
        state = levenberg_marquardt(state, linearise, PersonState.retract, settings).state
    return state.subject, state.frames


def _arrowhead(
    prior: PosePrior, objective: FrameObjective, scale: float, precision: Array, mean: Array, state: PersonState
) -> tuple[Array, Arrowhead]:
    xp = array_namespace(state.frames.z)
    frames = posed(prior, state.frames)
    d_pose_d_state, dof = d_pose_d_key(state.layout, prior, state.frames.z, state.frames.residual), frames.layout.dof
    J, gradient, information, cost = _point_jacobian(state.subject, frames, objective, scale)
    count = J.shape[0]

    def flat(matrices: Array) -> Array:
        return xp.reshape(matrices, (count, -1, matrices.shape[-1]))

    by_pose, by_shape = xp.matmul(J[..., :dof], d_pose_d_state[:, None]), J[..., dof:]
    by_pose_T, by_shape_T = xp.matrix_transpose(flat(by_pose)), xp.matrix_transpose(flat(by_shape))
    weighted_shape = flat(xp.matmul(information, by_shape))
    gradient = xp.reshape(gradient, (count, -1, 1))
    blocks, g_blocks = xp.matmul(by_pose_T, flat(xp.matmul(information, by_pose))), xp.matmul(by_pose_T, gradient)
    by_joints = d_pose_d_state[:, frames.layout.joints]
    by_joints_T = xp.matrix_transpose(by_joints)
    for term in objective.poses:
        evidence = term(frames.local)
        blocks = blocks + xp.matmul(by_joints_T, xp.matmul(term.hessian(evidence.factors), by_joints))
        g_blocks = g_blocks + xp.matmul(by_joints_T, evidence.gradient[..., None])
        cost = cost + evidence.cost
    value = _parameters(state.subject) - mean
    system = Arrowhead(
        blocks=blocks + 1e-2 * identity(d_pose_d_state.shape[-1], J),
        coupling=xp.matmul(by_pose_T, weighted_shape),
        shared=xp.sum(xp.matmul(by_shape_T, weighted_shape), axis=0) + precision,
        g_blocks=g_blocks[..., 0],
        g_shared=xp.sum(xp.matmul(by_shape_T, gradient)[..., 0], axis=0) + xp.matmul(precision, value),
    )
    return (xp.sum(cost) + 0.5 * xp.sum(value * xp.matmul(precision, value)))[None], system


def refit_shape(
    subject: Subject, frames: PosedFrames, objective: FrameObjective, scale: float, shape_prior: ShapePrior
) -> Subject:
    """Estimate the subject's body shape and landmark offsets again, from fixed poses."""
    if not (shape_prior.free_betas or shape_prior.free_offsets):
        return subject
    J, gradient, information, _ = _point_jacobian(subject, frames, objective, scale)
    xp = array_namespace(J)
    precision = _prior_precision(subject, shape_prior)
    by_shape = J[..., frames.layout.dof :]
    flat = xp.reshape(by_shape, (-1, by_shape.shape[-1]))
    H = shape_prior.evidence * xp.matmul(flat.T, xp.reshape(xp.matmul(information, by_shape), flat.shape))
    deviation = _parameters(subject) - _prior_mean(subject, shape_prior)
    g = shape_prior.evidence * xp.matmul(flat.T, xp.reshape(gradient, (-1,))) + xp.matmul(precision, deviation)
    step = DenseBlocks((H + precision)[None], g[None]).solve(xp.zeros_like(g[:1]))
    return moved(subject, step[0])


def moved(subject: Subject, step: Array) -> Subject:
    """Move the subject by a (10 + 3 L,) step in shape and landmark offsets."""
    xp = array_namespace(step)
    return replace(
        subject, betas=subject.betas + step[:10], offsets=subject.offsets + xp.reshape(step[10:], subject.offsets.shape)
    )


def _parameters(subject: Subject) -> Array:
    xp = array_namespace(subject.betas)
    return xp.concat([subject.betas, xp.reshape(subject.offsets, (-1,))])


def _prior_mean(subject: Subject, shape_prior: ShapePrior) -> Array:
    xp = array_namespace(subject.betas)
    betas = xp.zeros_like(subject.betas) if shape_prior.free_betas else subject.betas
    if kept := _kept_stature(subject, shape_prior):
        slope, along = kept
        betas = constant(along / (slope @ slope) * slope, subject.betas)
    offsets = xp.zeros_like(subject.offsets) if shape_prior.free_offsets else subject.offsets
    return xp.concat([betas, xp.reshape(offsets, (-1,))])


def _prior_precision(subject: Subject, shape_prior: ShapePrior) -> Array:
    betas = np.full(10, 1.0 if shape_prior.free_betas else FIXED)
    loose = np.asarray(shape_prior.offset_sigma_m) ** -2.0 if shape_prior.free_offsets else np.array(FIXED)
    precision = np.diag(np.r_[betas, np.repeat(np.broadcast_to(loose, len(subject.landmarks)), 3)])
    if kept := _kept_stature(subject, shape_prior):
        slope, _ = kept
        precision[:10, :10] += FIXED * np.outer(slope, slope) / (slope @ slope)
    return constant(precision, subject.betas)


def _kept_stature(subject: Subject, shape_prior: ShapePrior) -> tuple[np.ndarray, float] | None:
    """Return the (10,) slopes ``g`` of the stature, and ``g · betas`` at the given stature, or None if it is free."""
    given, body, betas = shape_prior.stature_m, subject.body, to_numpy(subject.betas)
    off = given - body.stature_of(betas)
    if not (shape_prior.free_betas and given) or abs(off) > STATURE_SIGMAS * LIMBS_SIGMA * given:
        return None
    heights = body.v_template[:, 1] + body.shapedirs[:, 1] @ betas
    slope = body.shapedirs[heights.argmax(), 1] - body.shapedirs[heights.argmin(), 1]
    return slope, float(off + slope @ betas)


def _point_jacobian(
    subject: Subject, frames: PosedFrames, objective: FrameObjective, scale: float
) -> tuple[Array, Array, Array, Array]:
    """Return the landmarks' derivatives, and the gradient, information and cost of the data."""
    posed = pose(subject, frames, jacobian=True)
    xp = array_namespace(posed.points)
    count, num = posed.points.shape[:2]
    eye = xp.broadcast_to(identity(3, posed.points), (count, num, 3, 3))
    assert posed.by_offsets is not None
    by_offsets = zeros((count, num, 3, 3 * num), posed.points)
    for i in range(num):
        by_offsets[:, i, :, 3 * i : 3 * i + 3] = posed.by_offsets[:, i]
    evidence = objective.of_points(posed.points, scale)
    J = xp.concat([posed.by_rotations, eye, posed.by_betas, by_offsets], axis=-1)
    return J, evidence.gradient, evidence.information, evidence.cost


SAMPLE_FRAMES = 32  # Number of frames from which the shape is learned.


def learn_subject(problem: Problem, subject: Subject, settings: SolveSettings, progress: Progress) -> Subject:
    """Estimate the subject's body shape from a sample of frames, unless the shape is given."""
    if known := problem.measurements.known_person:
        return known
    frames = sample_frames(problem.measurements, SAMPLE_FRAMES)
    progress("Learning the body", 0, 3)
    if settings.betas is None:
        subject = replace(subject, betas=lifted_betas(subject, problem.measurements, frames))
    states = fit_to_points(problem, subject, frames)
    progress("Learning the body", 1, 3)
    objective, steps = problem.objective.select(frames), LMSettings(settings.iterations)
    states = fit_frames(subject, problem.prior, objective, states, (4 * settings.robust_scale,), steps).state
    progress("Learning the body", 2, 3)
    scales = graduated_scales(settings.robust_scale, 3 * settings.robust_scale, 2)
    shape_prior = ShapePrior(free_betas=settings.betas is None, free_offsets=False, stature_m=problem.stature_m)
    subject, _ = fit_shape(subject, problem.prior, objective, states, scales, steps, shape_prior)
    progress("Learning the body", 3, 3)
    return subject


ALONG_SIGHT = 3.0
"""Factor applied to the speed limit along a single camera's line of sight. On 48 filmed takes, feet slide by 0.011
instead of 0.012 cm per frame, also with 2 or 4. With 4, feet in the benchmark's takes sink deeper below the floor."""
SLOW_SHARE = 0.2  # With one camera, a foot may be planted at up to this share of its high speeds.
_FOOT_POINTS = ("big_toe", "small_toe", "heel", "HEE", "TOE", "MT1", "MT5", "HAL")  # Foot points, without side.
_SOLE_POINTS = ("sole_heel", "sole_toe", "sole_inner", "sole_outer")  # Sole points, see ``with_soles``.
_SIDES = (("left_", "L"), ("right_", "R"))


@dataclass(frozen=True)
class Contacts:
    """Planted points on the feet, and their positions."""

    planted: np.ndarray  # (F, L) bool.
    anchors: np.ndarray  # (F, L, 3) metres, mean position during each contact, 0 elsewhere.

    def feet(self, names: tuple[str, ...]) -> np.ndarray | None:
        """Return an (F, 2) mask of frames in which the left or right foot is planted, or None without foot points."""
        feet = _foot_columns(names)
        if not feet:
            return None
        sides = [[k for k in feet if names[k].startswith(side)] for side in _SIDES]
        return np.stack([self.planted[:, columns].any(axis=1) for columns in sides], axis=1)

    def without_feet(self, names: tuple[str, ...], held: np.ndarray) -> Contacts:
        """Remove the contacts of feet in frames (F, 2) where other points hold the feet in place."""
        planted = self.planted.copy()
        for side, sign in enumerate(_SIDES):
            columns = [k for k in _foot_columns(names) if names[k].startswith(sign)]
            planted[:, columns] &= ~held[:, side, None]
        return replace(self, planted=planted)

    def term(self, like: Array, firmness: float = 1.0) -> PositionTerm:
        """Build the term that keeps planted points at their anchors."""
        return foot_contact_term(self.planted, self.anchors, like, SIGMA_M / firmness)


def find_contacts(
    points: np.ndarray,
    names: tuple[str, ...],
    fps: float,
    fixed: np.ndarray | None = None,
    sight: np.ndarray | None = None,
    heights: np.ndarray | None = None,
) -> Contacts:
    """Find frame ranges in which points on a foot are slow and low, so that it is planted.

    Args:
        points: (F, L, 3) solved positions in metres, Z up.
        fixed: (F,) bool, true for frames that do not change. If a contact includes such frames, they define its anchor.
        sight: (F, 3) unit viewing direction of a single camera, or None for several cameras.
        heights: (L,) heights in metres of a planted foot's points above a known floor, used as the anchors' heights.
          NaN for other points.
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


PRIOR_FRAMES = 60.0  # Weight of equal view variances in frames, because errors in neighbouring frames are correlated.
RANGE = (0.2, 5.0)  # Limits of a keypoint's variance in one view relative to the mean over all views.


def with_learned_noise(problem: Problem, subject: Subject, sample: PosedFrames, settings: SolveSettings) -> DataTerm:
    """Return the data term, with noise learned for each point and view if the settings ask for it."""
    data = problem.measurements.term
    if not settings.learn_noise:
        return data
    return reweighted(subject, sample, data, settings.robust_scale, problem.sample)


def reweighted(subject: Subject, frames: PosedFrames, term: DataTerm, scale: float, sample: np.ndarray) -> DataTerm:
    """Return the term with noise variances learned from a solution's residuals.

    ``v_cl = (Σ_f |r|²/d + n v_l) / (Σ_f (1 - h) + n)`` over the inliers of keypoint l in view c, in units of the
    variance assumed so far. r are residuals with d coordinates, v_l is the mean over views, and the prior counts as n
    frames. This is the restricted maximum likelihood of the log-variance (thesis eqs. 5.2, 5.3) under an inverse-gamma
    prior. h is the share of a view's error that the point absorbs, ``w J S⁻¹ Jᵀ`` with ``S = Σ_c w Jᵀ J``.

    The term uses ``v_cl / v_l``, because the disagreement of the views has already determined a keypoint's overall
    noise. Otherwise, a limb that the body does not follow yet would look noisy, and stay wrong. Points with one
    measurement are not used. Detections beyond ``scale`` standard deviations are excluded.
    """
    return reweighted_by_points(pose(subject, frames).points, term.select(sample), term, scale)


def reweighted_by_points(points: Array, part: DataTerm, term: DataTerm, scale: float) -> DataTerm:
    """Learn variances like ``reweighted``, from landmarks (S, L, 3) in S sample frames."""
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


WINDOW_S = 0.5  # Length of a window in seconds. Errors of markers and networks last about that long.
TAKE_FRAMES, WINDOW_FRAMES = 20.0, 10.0  # Weights, in frames, of the average landmark and of the take's mean.
LANDMARK_RANGE = (0.2, 25.0)  # Limits of the variance relative to the average landmark's.


def with_window_variances(
    term: DataTerm, points: Array, fps: float, scale: float, dof: float, looked_at: np.ndarray | None = None
) -> DataTerm:
    """Return the term with a noise variance for every landmark in each window of ``WINDOW_S``.

    ``v_lw = (Σ_{f in w} |r_lf|²/3 + n v_l) / (Σ_{f in w} (1 - h) + n)`` over the inliers, in units of the variance
    assumed so far. v_l is computed in the same way from the whole take, with the mean over all landmarks as prior. This
    is the maximum likelihood of the log-variances (thesis eqs. 5.2, 5.3 and Kendall and Gal 2017, eq. 8) in closed
    form, under inverse-gamma priors. h is the share of a landmark's error that the body absorbs: unknowns per measured
    coordinate. Values below the assumed level are not used, because a solution's residuals are always smooth.

    Args:
        term: landmarks that are measured once in each of the T frames.
        points: (F, L, 3) a solution's landmarks in metres, in the frames ``looked_at``.
        scale: landmarks beyond this many standard deviations are excluded.
        dof: unknowns of the solution per frame.
        looked_at: (T,) bool, true for the F frames of ``points``. None for all. A window without points gets v_l.
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
