"""Fit poses in single frames to triangulated points (thesis eq. 6.5)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from solver_backend.body.state_layout import RESIDUAL, StateLayout
from solver_backend.exchange.progress import Progress, silent
from solver_backend.fitters.model.subject import (
    FrameObjective,
    FrameStates,
    PosedFrames,
    Subject,
    d_pose_d_key,
    decoded,
    frame_equations,
    points_of,
    pose,
    state_layout,
)
from solver_backend.fitters.problem import Measurements, Problem, RoughMotion
from solver_backend.geometry.alignment import umeyama
from solver_backend.geometry.arrays import Array, array_namespace, astype, constant, identity, index, to_numpy, zeros
from solver_backend.geometry.interpolation import slerp
from solver_backend.geometry.parallel import block_size, map_blocks
from solver_backend.geometry.rotations import exp_so3, matrix_from_quat, quat_from_matrix
from solver_backend.priors.base import AutoencodingPrior, PosePrior
from solver_backend.priors.lifter import Lifted, load_lifter
from solver_backend.priors.prior_on_body import prior_on_body
from solver_backend.priors.sposer import load_sposer
from solver_backend.residuals.positions import PositionTerm
from solver_backend.solver.levenberg_marquardt import DenseBlocks, LazyNormalEquations, LMResult, LMSettings, minimise


def posed(prior: PosePrior, states: FrameStates) -> PosedFrames:
    """Decode states to poses."""
    return PosedFrames(states.root, decoded(prior, states.z, states.residual), states.transl)


def fit_frames(
    subject: Subject,
    prior: PosePrior,
    objective: FrameObjective,
    start: FrameStates,
    scales: tuple[float, ...],
    settings: LMSettings,
    progress: Progress = silent,
) -> LMResult[FrameStates]:
    """Fit each frame with decreasing robust scales, and return the result for the last scale."""
    problem = _FrameProblem(subject, prior, objective, state_layout(prior).without(RESIDUAL))
    if problem.layout.turned and start.residual is None:
        start = replace(start, residual=zeros((start.z.shape[0], len(prior.joints), 3), start.z))
    stages = [(scale, settings) for scale in scales]
    return minimise(problem, start, stages, select=_select, done=partial(progress, "Fitting frames"))


@dataclass(frozen=True)
class _FrameProblem:
    subject: Subject
    prior: PosePrior
    objective: FrameObjective
    layout: StateLayout

    def linearise(self, state: FrameStates, scale: float) -> tuple[Array, LazyNormalEquations]:
        prior, layout = self.prior, self.layout
        equations = frame_equations(self.subject, posed(prior, state), self.objective, scale, slice(None))

        def form() -> DenseBlocks:
            by_state = d_pose_d_key(layout, prior, state.z, state.residual)
            return _reduced(equations.hessian, equations.gradient, by_state)

        return equations.cost, LazyNormalEquations(form)

    def retract(self, state: FrameStates, step: Array) -> FrameStates:
        return state.retract(step, self.layout)


def bridged_states(states: FrameStates, seen: np.ndarray, num_frames: int) -> FrameStates:
    """Interpolate the states of observed frames (S,) to all frames, along geodesics."""
    frame = np.arange(num_frames)
    after = np.clip(np.searchsorted(seen, frame), 0, len(seen) - 1)
    before = np.where(seen[after] <= frame, after, np.maximum(after - 1, 0))
    after = np.where(frame > seen[-1], before, after)
    gap = np.maximum(seen[after] - seen[before], 1)
    share = constant(np.clip((frame - seen[before]) / gap, 0, 1), states.z)
    quat = quat_from_matrix(states.root)
    xp = array_namespace(quat)
    start, end = quat[before], quat[after]
    end = xp.where(xp.sum(start * end, axis=-1, keepdims=True) < 0, -end, end)
    transl = states.transl[before] + share[:, None] * (states.transl[after] - states.transl[before])
    root = matrix_from_quat(slerp(start, end, share))
    residual, codes = states.residual, slerp(states.z[before], states.z[after], share)
    if residual is not None:
        residual = residual[before] + share[:, None, None] * (residual[after] - residual[before])
    return FrameStates(codes, root, transl, residual)


def _select(mask: Array, new: FrameStates, old: FrameStates) -> FrameStates:
    return new.where(mask, old)


def _reduced(hessian: Array, gradient: Array, d_pose_d_state: Array) -> DenseBlocks:
    """Return regularised normal equations of the states: ``Cᵀ H C`` and ``Cᵀ g``. C is the derivative of the pose."""
    xp = array_namespace(hessian)
    C = xp.astype(d_pose_d_state, hessian.dtype)
    reduced = xp.astype(xp.matmul(xp.matrix_transpose(C), xp.matmul(hessian, C)), gradient.dtype)
    eye, C_T = identity(reduced.shape[-1], reduced), xp.matrix_transpose(d_pose_d_state)
    return DenseBlocks(reduced + 1e-2 * eye, xp.matmul(C_T, gradient[..., None])[..., 0])


Angles = tuple[float, float, float]


def _legs(left_hip: float, right_hip: float, left_knee: float, right_knee: float) -> dict[str, Angles]:
    names = ("left_hip", "right_hip", "left_knee", "right_knee")
    return {name: (bend, 0, 0) for name, bend in zip(names, (left_hip, right_hip, left_knee, right_knee), strict=True)}


_DOWN: dict[str, Angles] = {"left_shoulder": (0, 0, -1.2), "right_shoulder": (0, 0, 1.2)}
_WALKING: dict[str, Angles] = {**_DOWN, "left_elbow": (0, -0.8, 0), "right_elbow": (0, 0.8, 0)}
_START_POSES: tuple[dict[str, Angles], ...] = (
    _DOWN,
    {"left_shoulder": (0, 0, 0.9), "right_shoulder": (0, 0, -0.9)},
    {"left_shoulder": (0, -1.3, -0.2), "right_shoulder": (0, 1.3, 0.2)},
    {**_legs(-1.5, -1.5, 1.6, 1.6), "left_shoulder": (0, 0, -1.1), "right_shoulder": (0, 0, 1.1)},
    {**_legs(-0.7, 0.3, 0.4, 0.6), **_WALKING},
    {**_legs(0.3, -0.7, 0.6, 0.4), **_WALKING},
)
"""Axis-angle rotations in rad of start poses: standing, arms up, arms forward, squatting, two steps. Chosen by hand."""
STAGE = "Fitting single frames"
POSE_SIGMA_M = 0.03
"""Error in metres of points on a body of unknown shape. It is added to the measurement error."""
BLOCK_FRAMES = 64  # Number of frames fitted at a time.
NEAR, FAR = ((8.0,), 4), ((20.0, 5.0), 12)  # Robust scales and linearisations from lifted and from start poses.
TOLERANCE = 1e-2  # Initial values are good enough if no frame's cost decreases by more than this share.


def sample_frames(measurements: Measurements, count: int) -> np.ndarray:
    """Select up to ``count`` frames with the most points, spread over the take."""
    points = measurements.located.sum(-1)
    parts = np.array_split(np.arange(len(points)), min(count, len(points)))
    best = np.array([part[np.argmax(points[part])] for part in parts if len(part)])
    return best[points[best] >= max(4, 0.6 * points.max())]


def points_term(measurements: Measurements, frames: np.ndarray, like: Array) -> PositionTerm:
    """Build the position term of the known points in the given frames."""
    points, valid = measurements.points[frames], measurements.located[frames]
    variance = np.trace(measurements.covariance[frames], axis1=-2, axis2=-1) / 3
    weight = np.where(valid, 1.0 / (POSE_SIGMA_M**2 + np.nan_to_num(variance)), 0.0)
    return PositionTerm(constant(np.where(valid[..., None], points, 0.0), like), constant(weight, like))


def fit_to_points(problem: Problem, subject: Subject, frames: np.ndarray, progress: Progress = silent) -> FrameStates:
    """Fit poses to points in some frames, starting from the lifter's pose or the best of several start poses."""
    size = block_size(BLOCK_FRAMES, subject.betas)
    blocks = [frames[i : i + size] for i in range(0, len(frames), size)]
    report = partial(_report, progress, len(blocks))
    parts = map_blocks(lambda f: _fit_block(problem, subject, f), blocks, subject.betas, report)
    return FrameStates.concatenate(parts)


def _report(progress: Progress, total: int, done: int) -> None:
    progress(STAGE, done, total)


def _fit_block(problem: Problem, subject: Subject, frames: np.ndarray) -> FrameStates:
    prior, term = problem.prior, points_term(problem.measurements, frames, subject.betas)
    lifted = _lifted(subject, term)
    states, (scales, iterations) = _placed(subject, prior, lifted), NEAR
    if not bool(array_namespace(lifted.usable).all(lifted.usable)):
        states, (scales, iterations) = states.where(lifted.usable, _from_poses(subject, prior, term)), FAR
    objective = FrameObjective((term,), problem.pose_terms)
    return fit_frames(subject, prior, objective, states, scales, LMSettings(iterations, TOLERANCE)).state


def lifted_betas(subject: Subject, measurements: Measurements, frames: np.ndarray) -> Array:
    """Return the lifter's mean body shape (10,), or the subject's shape if no frame can be lifted."""
    lifted = _lifted(subject, points_term(measurements, frames, subject.betas))
    xp = array_namespace(lifted.betas)
    count = xp.sum(xp.astype(lifted.usable, lifted.betas.dtype))
    seen = xp.where(lifted.usable[:, None], lifted.betas, xp.zeros_like(lifted.betas))
    return subject.betas if count == 0 else xp.sum(seen, axis=0) / count


def _lifted(subject: Subject, term: PositionTerm) -> Lifted:
    return load_lifter()(term.positions, term.weight > 0, subject.landmarks.names)


def _placed(subject: Subject, prior: AutoencodingPrior, lifted: Lifted) -> FrameStates:
    rest, z = constant(subject.body.rest_joints(to_numpy(subject.betas))[0], lifted.z), lifted.z
    if prior.metadata.get("sha256") != load_lifter().metadata["sposer_sha256"]:  # the lifter's codes are SPoser's
        z = prior.encode(prior_on_body(load_sposer(), subject.body.layout).decode(z))
    return FrameStates(z, lifted.root, lifted.pelvis - rest)


def _from_poses(subject: Subject, prior: PosePrior, term: PositionTerm) -> FrameStates:
    xp = array_namespace(term.positions)
    starts = [_start(subject, prior, term, values) for values in _START_POSES]
    misfit = xp.stack([term(pose(subject, posed(prior, s)).points, 20.0).cost for s in starts])
    return _pick(starts, xp.argmin(misfit, axis=0))


def _pick(choices: list[FrameStates], index: Array) -> FrameStates:
    xp = array_namespace(index)
    frame = xp.arange(index.shape[0])
    stacked = [xp.stack([getattr(c, name) for c in choices])[index, frame] for name in ("z", "root", "transl")]
    return FrameStates(*stacked)


def _start(subject: Subject, prior: PosePrior, term: PositionTerm, values: dict[str, Any]) -> FrameStates:
    xp = array_namespace(term.positions)
    rotvec = np.zeros((len(prior.joints), 3))
    for joint in values.keys() & set(prior.joints):
        rotvec[prior.joints.index(joint)] = values[joint]
    z = prior.encode(exp_so3(constant(rotvec, term.positions))[None])
    eye = identity(3, z)[None]
    origin = PosedFrames(eye, prior.decode(z), xp.zeros_like(term.positions[:1, 0]))
    placed = pose(subject, origin)
    count = term.positions.shape[0]
    source = xp.broadcast_to(placed.points, term.positions.shape)
    _, R, t = umeyama(source, term.positions, term.weight)
    pelvis = placed.skeleton.joints[:, 0]
    transl = t + xp.matmul(R, pelvis[..., None])[..., 0] - pelvis
    return FrameStates(xp.broadcast_to(z, (count, z.shape[-1])), R, transl)


RATE_HZ, ANCHORS_HZ = 10.0, 2.0  # Fitted frames per second, and how many of them start without neighbours.
ROUGH_SCALES, ROUGH_STEPS = (30.0, 6.0), LMSettings(3, 3e-2)
"""Robust scales and steps. The wide scale finds distant limbs, and the narrow one then rejects wrong labels."""
STRAYED = 6.0  # If a frame's cost relative to the median exceeds this, it is fitted again without neighbours.


def rough_motion(problem: Problem, subject: Subject) -> RoughMotion:
    """Estimate poses at about ``RATE_HZ``. Poses at ``ANCHORS_HZ`` are fitted first and initialise the other poses."""
    seen = np.flatnonzero(problem.measurements.seen)
    frames = np.unique(np.append(seen[:: max(1, round(problem.fps / RATE_HZ))], seen[-1]))
    chosen = np.unique(np.append(np.arange(0, len(frames), round(RATE_HZ / ANCHORS_HZ)), len(frames) - 1))
    anchors = _fitted(problem, subject, frames[chosen], fit_to_points(problem, subject, frames[chosen]))[0]
    states, cost = _fitted(problem, subject, frames, bridged_states(anchors, chosen, len(frames)))
    strayed = np.flatnonzero(cost > STRAYED * np.median(cost))
    if len(strayed):
        again, anew = _fitted(problem, subject, frames[strayed], fit_to_points(problem, subject, frames[strayed]))
        better = np.zeros(len(frames), dtype=bool)
        better[strayed] = anew < cost[strayed]
        place = np.zeros(len(frames), dtype=int)
        place[strayed] = np.arange(len(strayed))
        states = again.select(index(place, states.z)).where(constant(better, states.z) > 0, states)
    return RoughMotion(frames, states)


def rough_markers(problem: Problem, subject: Subject, rough: RoughMotion) -> np.ndarray:
    """Return rough positions (F, L, 3) of the markers on the body in metres, in all frames."""
    xp = array_namespace(rough.states.z)
    states = bridged_states(rough.states.astype(xp.float32), rough.frames, problem.num_frames)
    points = points_of(subject.astype(xp.float32), posed(problem.prior, states))
    return to_numpy(astype(points, rough.states.z.dtype))


def _fitted(
    problem: Problem, subject: Subject, frames: np.ndarray, start: FrameStates
) -> tuple[FrameStates, np.ndarray]:
    size, single = block_size(BLOCK_FRAMES, start.z), array_namespace(start.z).float32
    parts = [slice(i, i + size) for i in range(0, len(frames), size)]

    def fit(part: slice) -> tuple[FrameStates, np.ndarray]:
        objective, begin = problem.objective.select(frames[part]).astype(single), start.select(part).astype(single)
        found = fit_frames(subject.astype(single), problem.prior, objective, begin, ROUGH_SCALES, ROUGH_STEPS)
        return found.state.astype(subject.betas.dtype), to_numpy(found.cost)

    found = map_blocks(fit, parts, start.z)
    return FrameStates.concatenate([state for state, _ in found]), np.concatenate([cost for _, cost in found])
