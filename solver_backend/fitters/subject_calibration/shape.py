"""Shape and detector bias from a sample of frames, together with the poses of those frames."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solver_backend.body.state_layout import RESIDUAL, UNCOVERED
from solver_backend.exchange.progress import Progress
from solver_backend.exchange.solve_settings import SolveSettings
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
from solver_backend.geometry.arrays import Array, array_namespace, constant, identity, zeros
from solver_backend.priors.base import PosePrior
from solver_backend.residuals.terms import graduated_scales
from solver_backend.solver.levenberg_marquardt import LMSettings, levenberg_marquardt
from solver_backend.solver.normal_equations import Arrowhead, DenseBlocks

FIXED = 1e12  # Precision of kept unknowns.


@dataclass(frozen=True)
class ShapePrior:
    """Prior knowledge of a person. The shape space has unit variance."""

    offset_sigma_m: float | np.ndarray = 0.02  # Deviation of a detector's points from ours; (L,), or one for all.
    evidence: float = 0.2  # Share of each frame's information that is new: detector noise is correlated in time.
    free_betas: bool = True  # False keeps a known shape.
    free_offsets: bool = True  # False keeps the landmarks where they are.


@dataclass(frozen=True)
class _ShapeState:
    subject: Subject
    frames: FrameStates


def fit_shape(
    subject: Subject,
    prior: PosePrior,
    objective: FrameObjective,
    start: FrameStates,
    scales: tuple[float, ...],
    settings: LMSettings,
    shape_prior: ShapePrior = ShapePrior(),
) -> tuple[Subject, FrameStates]:
    """Fit shape, landmark offsets and the poses of a sample of frames together (arrowhead normal equations).

    Args:
        subject: start of shape and offsets.
        scales: of Geman-McClure's penalty, falling.
    """
    state, layout = _ShapeState(subject, start), state_layout(prior).without(UNCOVERED, RESIDUAL)
    precision, mean = _prior_precision(subject, shape_prior), _prior_mean(subject, shape_prior)

    def retract(s: _ShapeState, step: Array) -> _ShapeState:
        m = precision.shape[0]
        by_frame = array_namespace(step).reshape(step[0, m:], (len(start.z), -1))
        return _ShapeState(moved(s.subject, step[0, :m]), s.frames.retract(by_frame, layout))

    for scale in scales:

        def linearise(s: _ShapeState, scale: float = scale) -> tuple[Array, Arrowhead]:
            return _arrowhead(prior, s, objective, scale, precision, mean)

        state = levenberg_marquardt(state, linearise, retract, settings).state
    return state.subject, state.frames


def _arrowhead(
    prior: PosePrior, state: _ShapeState, objective: FrameObjective, scale: float, precision: Array, mean: Array
) -> tuple[Array, Arrowhead]:
    xp = array_namespace(state.frames.z)
    frames, layout = posed(prior, state.frames), state_layout(prior).without(UNCOVERED, RESIDUAL)
    d_pose_d_state, dof = d_pose_d_key(layout, prior, state.frames.z, state.frames.residual), frames.layout.dof
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
        shared=xp.sum(xp.matmul(by_shape_T, weighted_shape), axis=0) + precision[:, None] * identity(len(value), J),
        g_blocks=g_blocks[..., 0],
        g_shared=xp.sum(xp.matmul(by_shape_T, gradient)[..., 0], axis=0) + precision * value,
    )
    return (xp.sum(cost) + 0.5 * xp.sum(precision * value * value))[None], system


def refit_shape(
    subject: Subject, frames: PosedFrames, objective: FrameObjective, scale: float, shape_prior: ShapePrior
) -> Subject:
    """Return the subject with shape and offsets re-estimated (one linear step) from fixed poses."""
    if not (shape_prior.free_betas or shape_prior.free_offsets):
        return subject
    J, gradient, information, _ = _point_jacobian(subject, frames, objective, scale)
    xp = array_namespace(J)
    precision = _prior_precision(subject, shape_prior)
    by_shape = J[..., frames.layout.dof :]
    flat = xp.reshape(by_shape, (-1, by_shape.shape[-1]))
    H = shape_prior.evidence * xp.matmul(flat.T, xp.reshape(xp.matmul(information, by_shape), flat.shape))
    deviation = _parameters(subject) - _prior_mean(subject, shape_prior)
    g = shape_prior.evidence * xp.matmul(flat.T, xp.reshape(gradient, (-1,))) + precision * deviation
    eye = identity(H.shape[0], H)
    step = DenseBlocks((H + precision[:, None] * eye)[None], g[None]).solve(xp.zeros_like(g[:1]))
    return moved(subject, step[0])


def moved(subject: Subject, step: Array) -> Subject:
    """Return the subject with shape and offsets moved by a (10 + 3 L,) step."""
    xp = array_namespace(step)
    return replace(
        subject, betas=subject.betas + step[:10], offsets=subject.offsets + xp.reshape(step[10:], subject.offsets.shape)
    )


def _parameters(subject: Subject) -> Array:
    xp = array_namespace(subject.betas)
    return xp.concat([subject.betas, xp.reshape(subject.offsets, (-1,))])


def _prior_mean(subject: Subject, shape_prior: ShapePrior) -> Array:
    """Return the (10 + 3 L,) mean of the shared unknowns: the average person without bias, or kept values."""
    xp = array_namespace(subject.betas)
    betas = xp.zeros_like(subject.betas) if shape_prior.free_betas else subject.betas
    offsets = xp.zeros_like(subject.offsets) if shape_prior.free_offsets else subject.offsets
    return xp.concat([betas, xp.reshape(offsets, (-1,))])


def _prior_precision(subject: Subject, shape_prior: ShapePrior) -> Array:
    """Return the (10 + 3 L,) precision of the shared unknowns. Kept ones have ``FIXED``."""
    betas = np.full(10, 1.0 if shape_prior.free_betas else FIXED)
    loose = np.asarray(shape_prior.offset_sigma_m) ** -2.0 if shape_prior.free_offsets else np.array(FIXED)
    offsets = np.repeat(np.broadcast_to(loose, len(subject.landmarks)), 3)
    return constant(np.concatenate([betas, offsets]), subject.betas)


def _point_jacobian(
    subject: Subject, frames: PosedFrames, objective: FrameObjective, scale: float
) -> tuple[Array, Array, Array, Array]:
    """Return (F, L, 3, p + 10 + 3 L) derivatives of the landmarks, and the evidence's gradient, information, cost."""
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


SAMPLE_FRAMES = 32  # Frames from which the shape is learned.


def learn_subject(problem: Problem, subject: Subject, settings: SolveSettings, progress: Progress) -> Subject:
    """Return the subject with the shape learned from a sample of frames, where the settings state none.

    A person who is known before the solve is kept.
    """
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
    shape_prior = ShapePrior(free_betas=settings.betas is None, free_offsets=False)
    subject, _ = fit_shape(subject, problem.prior, objective, states, scales, steps, shape_prior)
    progress("Learning the body", 3, 3)
    return subject
