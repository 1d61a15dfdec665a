"""The person being solved: body, landmarks, shape and the detector's bias, and the equations of one posed frame."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from array_api_compat import array_namespace

from solver_backend.body.body import Body
from solver_backend.body.landmarks import Landmarks, PosedLandmarks, pose_landmarks
from solver_backend.fitters.model.posed_frames import PosedFrames
from solver_backend.fitters.model.tangent import PoseTangent
from solver_backend.geometry.arrays import Array, identity, index
from solver_backend.residuals.point_term import PointTerm
from solver_backend.residuals.pose_mixture import usual_pose_curvature, usual_pose_term


@dataclass(frozen=True)
class Subject:
    """Everything that does not change over the take."""

    body: Body
    """The body model."""
    landmarks: Landmarks
    """The L observed points."""
    betas: Array
    """(10,) shape."""
    offsets: Array
    """(L, 3) metres: bias of each landmark in its rest frame."""


@dataclass(frozen=True)
class FrameEquations:
    """Gauss-Newton model of the data of each frame around its pose."""

    cost: Array
    """(F,)."""
    gradient: Array
    """(F, 69)."""
    _parts: tuple[Array, Array, Array]
    """Derivatives of the landmarks by turns, information and shares of the mixture, of the chosen frames."""

    @cached_property
    def hessian(self) -> Array:
        """(F, 69, 69), or those of the chosen frames; formed when asked for."""
        return _matrices(*self._parts)


def pose(subject: Subject, frames: PosedFrames, *, jacobian: bool = False) -> PosedLandmarks:
    """Return the subject's landmarks in these poses."""
    return pose_landmarks(
        subject.body, subject.landmarks, subject.betas, frames.root, frames.local, frames.transl,
        offsets=subject.offsets, jacobian=jacobian,
    )  # fmt: skip


def frame_equations(
    subject: Subject, frames: PosedFrames, term: PointTerm, scale: float, hessian_frames: np.ndarray | None = None
) -> FrameEquations:
    """Return ``g = Jᵀ e`` and ``H = Jᵀ Λ J`` of every frame by the 69 tangents of a pose, and what poses are like.

    Args:
        subject: the person.
        frames: F poses.
        term: their data.
        scale: of Geman-McClure's penalty.
        hessian_frames: those whose matrices are wanted, in single precision, as they only steer the steps; None: all.
    """
    posed = pose(subject, frames, jacobian=True)
    xp = array_namespace(posed.points)
    count = posed.points.shape[0]
    evidence = term(posed.points, scale)
    energy, usual_pull, shares = usual_pose_term(frames.local)
    J, pull = posed.by_rotations, evidence.gradient
    assert J is not None
    turned = xp.matrix_transpose(xp.reshape(J, (count, -1, J.shape[-1])))
    by_rotations = xp.matmul(turned, xp.reshape(pull, (count, -1, 1)))[..., 0]
    by_rotations[:, PoseTangent.JOINTS] += usual_pull
    gradient = xp.concat([by_rotations, xp.sum(pull, axis=1)], axis=-1)
    parts = J, evidence.information, shares
    if hessian_frames is not None:
        chosen = index(hessian_frames, J)
        parts = tuple(xp.astype(part[chosen], xp.float32) for part in parts)
    return FrameEquations(evidence.cost + energy, gradient, parts)


def _matrices(by_rotations: Array, information: Array, shares: Array) -> Array:
    """Return the (F, 69, 69) Gauss-Newton matrices of the data and of what poses are like."""
    xp = array_namespace(by_rotations)
    count, num_landmarks = by_rotations.shape[:2]
    eye = identity(3, by_rotations)
    J = xp.concat([by_rotations, xp.broadcast_to(eye, (count, num_landmarks, 3, 3))], axis=-1)
    weighted = xp.reshape(xp.matmul(information, J), (count, 3 * num_landmarks, PoseTangent.DOF))
    hessian = xp.matmul(xp.matrix_transpose(xp.reshape(J, weighted.shape)), weighted)
    hessian[:, PoseTangent.JOINTS, PoseTangent.JOINTS] += usual_pose_curvature(shares)
    return hessian
