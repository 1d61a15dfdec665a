"""The person being solved: body, landmarks, shape and the detector's bias, and the equations of one posed frame."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from operator import add
from typing import Any

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.landmark_set import Landmarks
from solver_backend.body.landmarks import PosedLandmarks, pose_landmarks
from solver_backend.body.state_layout import PoseLayout
from solver_backend.fitters.model.states import BLOCK_POSES, PosedFrames
from solver_backend.geometry.arrays import Array, array_namespace, astype, constant, empty, index
from solver_backend.geometry.parallel import map_blocks
from solver_backend.geometry.small_matrices import sum_of_rows
from solver_backend.residuals.positions import without_shift
from solver_backend.residuals.terms import PointEvidence, PointTerm, PoseTerm


@dataclass(frozen=True)
class FrameObjective:
    """The terms on F frames."""

    points: tuple[PointTerm, ...]  # On landmark positions; at least one.
    poses: tuple[PoseTerm, ...] = ()  # On the joints' rotations.
    relative: tuple[PointTerm, ...] = ()  # On landmark positions except for a common shift.

    def select(self, frames: Any) -> FrameObjective:
        """Return the terms of the frames at these indices or of this slice."""
        return self._each(lambda term: term.select(frames))

    def astype(self, precision: Any) -> FrameObjective:
        """Return the terms in a precision."""
        return self._each(lambda term: term.astype(precision))

    def _each(self, change: Callable[[Any], Any]) -> FrameObjective:
        return FrameObjective(*(tuple(map(change, terms)) for terms in (self.points, self.poses, self.relative)))

    def of_points(self, points: Array, scale: float) -> PointEvidence:
        """Return the sum of the point terms at (F, L, 3) positions; ``scale`` is the robust scale."""
        return reduce(add, [term(points, scale) for term in self.points])


@dataclass(frozen=True)
class Subject:
    """The person: all that does not change over the take."""

    body: Body
    landmarks: Landmarks
    betas: Array  # (10,) shape.
    offsets: Array  # (L, 3) metres: bias of each landmark in its rest frame.

    @classmethod
    def average(cls, body: Body, landmarks: Landmarks, like: Array) -> Subject:
        """Return the average person without bias, in arrays like ``like``."""
        return cls(body, landmarks, constant(np.zeros(10), like), constant(np.zeros((len(landmarks), 3)), like))

    def astype(self, precision: Any) -> Subject:
        """Return the person in a precision."""
        return replace(self, betas=astype(self.betas, precision), offsets=astype(self.offsets, precision))


@dataclass(frozen=True)
class FrameEquations:
    """Gauss-Newton model of the objective of each frame around its pose."""

    cost: Array  # (F,).
    gradient: Array  # (F, p).
    _form: Callable[[], Array]

    @cached_property
    def hessian(self) -> Array:
        """(F, p, p), or those of the chosen frames; formed on demand."""
        return self._form()


def pose(subject: Subject, frames: PosedFrames, *, jacobian: bool = False, by_shape: bool = True) -> PosedLandmarks:
    """Return the subject's landmarks in these poses; see ``pose_landmarks``."""
    person, poses = (subject.body, subject.landmarks, subject.betas), (frames.root, frames.local, frames.transl)
    return pose_landmarks(*person, *poses, offsets=subject.offsets, jacobian=jacobian, by_shape=by_shape)


def points_of(subject: Subject, frames: PosedFrames) -> Array:
    """Return the subject's landmarks (F, L, 3) in these poses, some frames at a time."""
    blocks = [slice(start, start + BLOCK_POSES) for start in range(0, frames.transl.shape[0], BLOCK_POSES)]
    parts = map_blocks(lambda block: pose(subject, frames.select(block)).points, blocks, frames.transl)
    return array_namespace(frames.transl).concat(parts)


def frame_equations(
    subject: Subject,
    frames: PosedFrames,
    objective: FrameObjective,
    scale: float,
    hessian_frames: np.ndarray | slice | None = None,
) -> FrameEquations:
    """Return ``g = Jᵀ e`` and ``H = Jᵀ Λ J`` of every frame's objective by the tangent of its pose, see ``PoseLayout``.

    Args:
        objective: of these frames.
        hessian_frames: frames whose matrices are formed, in single precision, as they only steer the steps; None forms
            all in the poses' precision.
    """
    posed = pose(subject, frames, jacobian=True, by_shape=False)
    xp = array_namespace(posed.points)
    count = posed.points.shape[0]
    shifted = [term(posed.points, scale) for term in objective.relative]
    data = reduce(add, shifted, objective.of_points(posed.points, scale))
    poses = [term(frames.local) for term in objective.poses]
    J = posed.by_rotations
    assert J is not None
    J_T = xp.matrix_transpose(xp.reshape(J, (count, -1, J.shape[-1])))
    by_rotations = xp.matmul(J_T, xp.reshape(data.gradient, (count, -1, 1)))[..., 0]
    cost = data.cost
    for term in poses:
        by_rotations[:, frames.layout.joints] += term.gradient
        cost = cost + term.cost
    gradient = xp.concat([by_rotations, sum_of_rows(data.gradient)], axis=-1)
    about = [evidence.information for evidence in shifted]
    parts = [J, data.information, *about, *(term.factors for term in poses)]
    if hessian_frames is not None:
        chosen = hessian_frames if isinstance(hessian_frames, slice) else index(hessian_frames, J)
        parts = [astype(part[chosen], xp.float32) for part in parts]
    return FrameEquations(cost, gradient, lambda: _hessian(objective.poses, len(about), *parts))


def _hessian(
    terms: tuple[PoseTerm, ...], shifted: int, by_rotations: Array, information: Array, *factors: Array
) -> Array:
    """Return the (F, p, p) Gauss-Newton matrices of the point terms and the pose terms; see ``without_shift``."""
    xp = array_namespace(by_rotations)
    count, num_landmarks, _, rotations = by_rotations.shape
    weighted = xp.matmul(information, by_rotations)
    tall, layout = (count, 3 * num_landmarks, rotations), PoseLayout(rotations // 3 - 1)
    across, hessian = xp.sum(weighted, axis=1), empty((count, layout.dof, layout.dof), by_rotations)
    hessian[:, layout.rotations, layout.rotations] = xp.matmul(
        xp.matrix_transpose(xp.reshape(by_rotations, tall)), xp.reshape(weighted, tall)
    )
    hessian[:, layout.transl, layout.rotations] = across
    hessian[:, layout.rotations, layout.transl] = xp.matrix_transpose(across)
    hessian[:, layout.transl, layout.transl] = xp.reshape(
        sum_of_rows(xp.reshape(information, (count, num_landmarks, 9))), (count, 3, 3)
    )
    for part in factors[:shifted]:
        total = xp.sum(part, axis=1)
        rows = xp.concat([xp.sum(xp.matmul(part, by_rotations), axis=1), total], axis=-1)
        hessian -= without_shift(rows, total)
    for term, part in zip(terms, factors[shifted:], strict=True):
        hessian[:, layout.joints, layout.joints] += term.hessian(part)
    return hessian
