"""Pose and shape from 2D keypoints with Pose-NDF as the prior (Tiwari et al. 2022, eqs. 10 and 11)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from solver_backend.body.state_layout import PoseLayout
from solver_backend.exchange.joint_sets import NUM_BETAS
from solver_backend.exchange.progress import Progress, silent
from solver_backend.fitters.model.states import PosedFrames
from solver_backend.fitters.model.subject import Subject, pose
from solver_backend.geometry.arrays import Array, array_namespace, constant, identity, zeros
from solver_backend.geometry.rotations import left_jacobian_inverse_so3, log_so3
from solver_backend.priors.pose_ndf.pose_ndf import TURN_METRIC, PoseNDF
from solver_backend.residuals.terms import PointTerm, graduated_scales
from solver_backend.solver.block_tridiagonal import BlockTridiagonal
from solver_backend.solver.levenberg_marquardt import LMSettings, levenberg_marquardt
from solver_backend.solver.normal_equations import Arrowhead

BENDS: tuple[tuple[int, int, float], ...] = ((3, 0, -1.0), (4, 0, -1.0), (17, 1, 1.0), (18, 1, -1.0))
"""Column of each knee and elbow, axis of its rotation vector, and sign of the way it does not bend."""


@dataclass(frozen=True)
class KeypointSettings:
    """Weights of (10); the data term is in squared standard deviations of the detector's noise."""

    manifold: float = 50.0  # w, 1/rad²: ``λ_θ = w f(θ)``, so that the term ``w f² / 2`` lets go near the manifold.
    adaptive: bool = True  # False for a constant ``λ_θ = w``, 1/rad, to compare.
    shape: float = 1.0  # λ_β, of ``|β|² / 2``.
    bending: float = 1.0  # λ_α, of ``exp(2 α) / 2`` over knees and elbows, α the angle of bending the wrong way.
    robust_scale: float = 3.0
    """Geman-McClure scale in standard deviations; reached from four times as much in three steps."""
    iterations: int = 20  # Linearisations at most for each robust scale.


@dataclass(frozen=True)
class KeypointFit:
    """What the keypoints were explained by."""

    frames: PosedFrames
    betas: Array  # (10,) one shape for all frames.
    cost: float
    status: str  # One sentence on why the search stopped.


@dataclass(frozen=True)
class KeypointObjective:
    """``L_J + λ_θ L_θ + λ_β L_β + λ_α L_α`` of F frames of one person (10)."""

    subject: Subject
    prior: PoseNDF
    term: PointTerm  # Robust distance of landmarks to keypoints, such as ``ReprojectionTerm``, of one view or several.
    settings: KeypointSettings
    scale: float

    def linearise(self, state: tuple[PosedFrames, Array]) -> tuple[Array, Arrowhead]:
        """Return the cost (1,) and its equations: the tangents of each frame's pose, and the shape that all share."""
        frames, betas = state
        posed = pose(replace(self.subject, betas=betas), frames, jacobian=True)
        xp = array_namespace(posed.points)
        evidence = self.term(posed.points, self.scale)
        count, num_landmarks = posed.points.shape[:2]
        eye = xp.broadcast_to(identity(3, betas), (count, num_landmarks, 3, 3))
        J = xp.concat([posed.by_rotations, eye, posed.by_betas], axis=-1)
        weighted = xp.reshape(xp.matmul(evidence.information, J), (count, 3 * num_landmarks, -1))
        J_T = xp.permute_dims(xp.reshape(J, (count, 3 * num_landmarks, -1)), (0, 2, 1))
        H = xp.matmul(J_T, weighted)
        g = xp.matmul(J_T, xp.reshape(evidence.gradient, (count, -1, 1)))[..., 0]
        prior_cost, prior_g, prior_H = self._pose_terms(frames)
        s, dof = self.settings, frames.layout.dof
        cost = xp.sum(evidence.cost) + prior_cost + 0.5 * s.shape * xp.sum(betas * betas)
        return xp.reshape(cost, (1,)), Arrowhead(
            H[:, :dof, :dof] + prior_H,
            H[:, :dof, dof:],
            xp.sum(H[:, dof:, dof:], axis=0) + s.shape * identity(NUM_BETAS, betas),
            g[:, :dof] + prior_g,
            xp.sum(g[:, dof:], axis=0) + s.shape * betas,
        )

    def retract(self, state: tuple[PosedFrames, Array], step: Array) -> tuple[PosedFrames, Array]:
        """Return the state moved by (1, 10 + p F) steps, the shape first."""
        xp = array_namespace(step)
        frames, betas = state
        moves = xp.reshape(step[0, NUM_BETAS:], (-1, frames.layout.dof))
        return frames.retract(moves), betas + step[0, :NUM_BETAS]

    def _pose_terms(self, frames: PosedFrames) -> tuple[Array, Array, Array]:
        """Return cost, gradient (F, p) and curvature (F, p, p) of the manifold and of bending."""
        xp = array_namespace(frames.local)
        bend_cost, bend_g, bend_curvature = bending(frames.local, self.settings.bending)
        distance, by_joints = self.prior.distance_with_tangents(frames.local)
        w, by_joints = self.settings.manifold, xp.reshape(by_joints, (len(distance), -1))
        if self.settings.adaptive:
            cost, own_g, stiff = 0.5 * w * xp.sum(distance**2), w * distance[:, None] * by_joints, w + 0.0 * distance
        else:
            cost, own_g, stiff = w * xp.sum(distance), w * by_joints, w / xp.clip(distance, 1e-3, None)
        metric = constant(np.diag(np.repeat(TURN_METRIC, 3)), distance)
        curvature = bend_curvature + stiff[:, None, None] * metric
        g = zeros((len(distance), frames.layout.dof), distance)
        H = xp.zeros_like(g)[:, :, None] * g[:, None, :]
        joints = frames.layout.joints
        g[:, joints], H[:, joints, joints] = bend_g + own_g, curvature
        return cost + bend_cost, g, H


def bending(local: Array, weight: float) -> tuple[Array, Array, Array]:
    """Return ``λ_α/2 Σ exp(2 α)``, its gradient (F, 63) and its curvature (F, 63, 63) by the joints' left tangents."""
    xp = array_namespace(local)
    vectors = log_so3(local)
    inverse, count = left_jacobian_inverse_so3(vectors), local.shape[0]
    penalties, slopes = [], []
    for joint, axis, sign in BENDS:
        penalty = xp.exp(sign * vectors[:, joint, axis])
        one = constant(np.eye(vectors.shape[1])[joint], penalty)[None, :, None]
        slope = (sign * penalty)[:, None] * inverse[:, joint, axis, :]
        penalties.append(penalty)
        slopes.append(xp.reshape(one * slope[:, None, :], (count, -1)))
    r, J = xp.stack(penalties, axis=1), xp.stack(slopes, axis=1)
    J_T = xp.permute_dims(J, (0, 2, 1))
    return 0.5 * weight * xp.sum(r * r), weight * xp.matmul(J_T, r[..., None])[..., 0], weight * xp.matmul(J_T, J)


def fit_keypoints(
    subject: Subject,
    prior: PoseNDF,
    term: PointTerm,
    start: PosedFrames,
    settings: KeypointSettings = KeypointSettings(),
) -> KeypointFit:
    """Return the poses and the shape that minimise (10), from a start that faces the right way.

    Args:
        subject: body and the landmarks that the keypoints are; its shape is where the search starts.
        prior: whose distance is ``L_θ``.
        term: the keypoints' constraint on the landmarks.
        start: F poses, roughly placed before the cameras.
        settings: weights.

    Raises:
        PoseInvalid: start poses that are NaN or off SO(3).
    """
    state, result = (start, subject.betas), None
    stopping = LMSettings(max_iterations=settings.iterations, tolerance=1e-5)
    for scale in graduated_scales(settings.robust_scale, 4 * settings.robust_scale, 3):
        objective = KeypointObjective(subject, prior, term, settings, scale)
        result = levenberg_marquardt(state, objective.linearise, objective.retract, stopping)
        state = result.state
    assert result is not None
    return KeypointFit(*state, cost=float(result.cost[0]), status=result.status)


@dataclass(frozen=True)
class ManifoldWeights:
    """Weights of the three terms; points count as the mean over the landmarks."""

    data: float  # λ_v, 1/m²: of the observed points.
    manifold: float  # w, 1/rad²: ``λ_θ = w f`` makes the prior's term ``w f²``, weak near the manifold (sec. 4.3).
    smoothness: float  # λ_t, 1/m²: of the way of a frame's points from those of the frame before.
    level: float = 0.0
    """rad; a pose as near to the manifold as this is not pulled, so that recorded poses are left as they are."""


@dataclass(frozen=True)
class PoseSequence:
    """The objective of F consecutive frames."""

    subject: Subject  # Whose landmarks stand for the mesh.
    prior: PoseNDF
    weights: ManifoldWeights
    observed: Array  # (F, L, 3) metres.
    seen: Array  # (F, L) one where a point is observed, zero where not (its position may be anything finite).
    free: tuple[int, ...]  # Which columns of a frame's ``PoseLayout`` may move.
    before: Array | None = None  # (L, 3) points of the frame before the first; None at the start of a take.

    def linearise(self, frames: PosedFrames) -> tuple[Array, BlockTridiagonal]:
        """Return the cost (1,) and its Gauss-Newton equations in the free tangents.

        ``E = 1/2 Σ_t [λ_v/L Σ_l s |y - o|² + w e² + λ_t/L Σ_l |y_t - y_{t-1}|²]`` with ``e = max(f - level, 0)``: L_v,
        L_θ and L_t of Pose-NDF's eqs. 7 and 8, with landmarks for the mesh and all frames at once. The
        residual of the prior is the way to the manifold, not its length alone: ``e²/2`` bends as the metric does.
        """
        posed = pose(self.subject, frames, jacobian=True)
        xp = array_namespace(posed.points)
        count, num_landmarks = posed.points.shape[:2]
        J = _free_columns(xp, posed.by_rotations, list(self.free))
        J_T = xp.permute_dims(J, (0, 2, 1))
        data, smooth = self.weights.data / num_landmarks, self.weights.smoothness / num_landmarks
        error = self.seen[..., None] * (posed.points - self.observed)
        step = posed.points[1:] - posed.points[:-1]
        first = posed.points[:1] * 0.0 if self.before is None else posed.points[:1] - self.before
        arriving, leaving = xp.concat([first, step]), xp.concat([step, posed.points[:1] * 0.0])
        distance, by_joints = self.prior.distance_with_tangents(frames.local)
        distance = xp.clip(distance - self.weights.level, 0.0, None)
        by_free = _of_joints(xp, by_joints, frames.layout)[:, list(self.free)]

        by_points = xp.reshape(data * error + smooth * (arriving - leaving), (count, -1, 1))
        w = self.weights.manifold
        g = xp.matmul(J_T, by_points)[..., 0] + w * distance[:, None] * by_free
        neighbours = self._neighbours(xp, posed.points)
        stiff = data * self.seen + smooth * neighbours[:, None]
        stiff = xp.reshape(xp.broadcast_to(stiff[..., None], posed.points.shape), (count, -1, 1))
        bend = np.zeros(frames.layout.dof)
        bend[frames.layout.joints] = np.repeat(TURN_METRIC, 3)
        diagonal = xp.matmul(J_T, stiff * J) + constant(w * np.diag(bend[list(self.free)]), stiff)
        cost = 0.5 * (data * xp.sum(error * error) + smooth * xp.sum(arriving**2) + w * xp.sum(distance**2))
        upper = -smooth * xp.matmul(J_T[:-1], J[1:])
        return xp.reshape(cost, (1,)), BlockTridiagonal(diagonal, upper, g)

    def _neighbours(self, xp: Any, points: Array) -> Array:
        """Return (F,) how many frames each frame is tied to."""
        ones = xp.ones_like(points[:, 0, 0])
        linked = xp.ones_like(ones[:1]) if self.before is not None else ones[:1] * 0.0
        return xp.concat([linked, ones[1:]]) + xp.concat([ones[1:], ones[:1] * 0.0])

    def retract(self, frames: PosedFrames, step: Array) -> PosedFrames:
        """Return the frames moved by (1, F n) steps in the free tangents."""
        xp = array_namespace(step)
        count = frames.root.shape[0]
        whole = zeros((count, frames.layout.dof), step)
        whole[:, list(self.free)] = xp.reshape(step, (count, -1))
        return frames.retract(whole)


def _free_columns(xp: Any, by_rotations: Array | None, free: list[int]) -> Array:
    """Return (F, 3 L, n) derivatives of the points by the free tangents."""
    assert by_rotations is not None
    count, num_landmarks = by_rotations.shape[:2]
    eye = identity(3, by_rotations)
    J = xp.concat([by_rotations, xp.broadcast_to(eye, (count, num_landmarks, 3, 3))], axis=-1)
    return xp.reshape(J, (count, 3 * num_landmarks, -1))[..., free]


def _of_joints(xp: Any, by_joints: Array, layout: PoseLayout) -> Array:
    """Return (F, p) from (F, J, 3): zero for the root and the translation."""
    whole = zeros((by_joints.shape[0], layout.dof), by_joints)
    whole[:, layout.joints] = xp.reshape(by_joints, (by_joints.shape[0], -1))
    return whole


CHUNK_FRAMES = 240  # Frames solved at once, as the paper's longest sequences.


def solve_sequence(
    sequence: PoseSequence, start: PosedFrames, iterations: int, stage: str = "Fitting", progress: Progress = silent
) -> tuple[PosedFrames, Array]:
    """Return the poses that minimise the sequence's cost, and the cost (1,) summed over the chunks.

    Args:
        sequence: all frames of the take.
        start: where to start.
        iterations: linearisations at most for each chunk.
        stage: what the work is called to the user.
        progress: called after every chunk.
    """
    count = start.transl.shape[0]
    parts, stopping = list[PosedFrames](), LMSettings(max_iterations=iterations, tolerance=1e-5)
    total, before = 0.0, sequence.before
    for first in range(0, count, CHUNK_FRAMES):
        frames = slice(first, min(first + CHUNK_FRAMES, count))
        part = replace(sequence, observed=sequence.observed[frames], seen=sequence.seen[frames], before=before)
        found = levenberg_marquardt(start.select(frames), part.linearise, part.retract, stopping)
        parts.append(found.state)
        total = total + found.cost
        before = pose(sequence.subject, found.state.select(slice(-1, None))).points[0]
        progress(stage, frames.stop, count)
    return PosedFrames.concatenate(parts), total
