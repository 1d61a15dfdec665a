"""Levenberg-Marquardt over takes of any length: chunks of frames, each joined to the last frame of the one before."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from solver_backend.body.state_layout import PoseLayout
from solver_backend.exchange.progress import Progress, silent
from solver_backend.fitters.model.states import PosedFrames
from solver_backend.fitters.model.subject import Subject, pose
from solver_backend.geometry.arrays import Array, array_namespace, constant, identity, zeros
from solver_backend.priors.pose_ndf.pose_ndf import TURN_METRIC, PoseNDF
from solver_backend.solver.block_tridiagonal import BlockTridiagonal
from solver_backend.solver.levenberg_marquardt import LMSettings, levenberg_marquardt


@dataclass(frozen=True)
class ManifoldWeights:
    """Weights of the three terms; points count as the mean over the landmarks."""

    data: float
    """λ_v, 1/m²: of the observed points."""
    manifold: float
    """w, 1/rad²: ``λ_θ = w f`` makes the prior's term ``w f²``, weak near the manifold (sec. 4.3)."""
    smoothness: float
    """λ_t, 1/m²: of the way of a frame's points from those of the frame before."""
    level: float = 0.0
    """rad; a pose as near to the manifold as this is not pulled, so that recorded poses are left as they are."""


@dataclass(frozen=True)
class PoseSequence:
    """The objective of F consecutive frames."""

    subject: Subject
    """Whose landmarks stand for the mesh."""
    prior: PoseNDF
    weights: ManifoldWeights
    observed: Array
    """(F, L, 3) metres."""
    seen: Array
    """(F, L) one where a point is observed, zero where not (its position may be anything finite)."""
    free: tuple[int, ...]
    """Which columns of a frame's ``PoseLayout`` may move."""
    before: Array | None = None
    """(L, 3) points of the frame before the first; None at the start of a take."""

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


CHUNK_FRAMES = 240
"""Frames solved at once, as the paper's longest sequences."""


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
    parts: list[PosedFrames] = []
    total, before = 0.0, sequence.before
    for first in range(0, count, CHUNK_FRAMES):
        frames = slice(first, min(first + CHUNK_FRAMES, count))
        part = replace(sequence, observed=sequence.observed[frames], seen=sequence.seen[frames], before=before)
        found = levenberg_marquardt(
            start.select(frames), part.linearise, part.retract,
            LMSettings(max_iterations=iterations, tolerance=1e-5),
        )  # fmt: skip
        parts.append(found.state)
        total = total + found.cost
        before = pose(sequence.subject, found.state.select(slice(-1, None))).points[0]
        progress(stage, frames.stop, count)
    return PosedFrames.concatenate(parts), total
