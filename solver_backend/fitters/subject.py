"""The person being solved: body, landmarks, shape and the detector's bias, and the equations of one posed frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from array_api_compat import array_namespace

from solver_backend.body.body import Body
from solver_backend.body.landmarks import Landmarks, PosedLandmarks, pose_landmarks
from solver_backend.geometry.arrays import Array
from solver_backend.residuals.evidence import PointEvidence, PointTerm
from solver_backend.residuals.usual_poses import usual_pose_term

FRAME_DOF = 69
"""Tangent of a posed frame: root rotation 3 (world), joints 1..21 63 (each in its parent's frame), translation 3."""


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
class PosedFrames:
    """Poses of F frames."""

    root: Array
    """(F, 3, 3) body to world."""
    local: Array
    """(F, 21, 3, 3) rotations of joints 1..21."""
    transl: Array
    """(F, 3) metres."""


@dataclass(frozen=True)
class FrameEquations:
    """Gauss-Newton model of the data of each frame around its pose."""

    cost: Array
    """(F,)."""
    gradient: Array
    """(F, 69)."""
    hessian: Array
    """(F, 69, 69)."""


def pose(subject: Subject, frames: PosedFrames, *, jacobian: bool = False) -> PosedLandmarks:
    """Return the subject's landmarks in these poses."""
    return pose_landmarks(
        subject.body, subject.landmarks, subject.betas, frames.root, frames.local, frames.transl,
        offsets=subject.offsets, jacobian=jacobian,
    )  # fmt: skip


def frame_equations(subject: Subject, frames: PosedFrames, term: PointTerm, scale: float) -> FrameEquations:
    """Return ``g = Jᵀ e`` and ``H = Jᵀ Λ J`` of every frame by the 69 tangents of a pose, and what poses are like."""
    posed = pose(subject, frames, jacobian=True)
    xp = array_namespace(posed.points)
    count, num_landmarks = posed.points.shape[:2]
    eye = xp.eye(3, dtype=posed.points.dtype, device=getattr(posed.points, "device", None))
    eye = xp.broadcast_to(eye, (count, num_landmarks, 3, 3))
    J = xp.concat([posed.by_rotations, eye], axis=-1)
    evidence = term(posed.points, scale)
    weighted = xp.reshape(xp.matmul(evidence.information, J), (count, 3 * num_landmarks, FRAME_DOF))
    flat = xp.permute_dims(xp.reshape(J, (count, 3 * num_landmarks, FRAME_DOF)), (0, 2, 1))
    gradient = xp.matmul(flat, xp.reshape(evidence.gradient, (count, -1))[..., None])[..., 0]
    return _with_usual_poses(frames, evidence.cost, gradient, xp.matmul(flat, weighted))


def _with_usual_poses(frames: PosedFrames, cost: Array, gradient: Array, hessian: Array) -> FrameEquations:
    """Add what poses are like to the joints' part of the equations."""
    energy, pull, curvature = usual_pose_term(frames.local)
    gradient[:, 3:66] += pull
    hessian[:, 3:66, 3:66] += curvature
    return FrameEquations(cost + energy, gradient, hessian)


def shape_equations(
    subject: Subject, frames: PosedFrames, term: PointTerm, scale: float
) -> tuple[PosedLandmarks, PointEvidence]:
    """Return the posed landmarks with all derivatives, and the evidence there."""
    posed = pose(subject, frames, jacobian=True)
    return posed, term(posed.points, scale)


def select_frames(frames: PosedFrames, index: Any) -> PosedFrames:
    """Return the poses at these indices."""
    return PosedFrames(frames.root[index], frames.local[index], frames.transl[index])
