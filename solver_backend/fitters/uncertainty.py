"""How sure the solve is of each joint: the posterior of the keyframes, carried to the joints of every frame."""

from __future__ import annotations

import numpy as np
from array_api_compat import array_namespace

from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.body.landmarks import pose_landmarks
from solver_backend.fitters.between import key_tangents
from solver_backend.fitters.bundle import BundleModel
from solver_backend.fitters.keyframes import KeyframeLayout, Keyframes, lagrange
from solver_backend.fitters.subject import PosedFrames, Subject, pose, select_frames
from solver_backend.geometry.arrays import Array, constant
from solver_backend.geometry.parallel import map_blocks
from solver_backend.residuals.reprojection import ReprojectionTerm
from solver_backend.solver.normal_equations import BlockTridiagonal
from solver_backend.types import JointSet


def joint_covariance(
    model: BundleModel, layout: KeyframeLayout, keys: Keyframes, frames: PosedFrames, system: BlockTridiagonal,
    inflation: float,
) -> Array:  # fmt: skip
    """Return (F, 24, 3, 3) posterior covariances of the joints in square metres: ``J B S Bᵀ Jᵀ``.

    S is the posterior covariance of the three keys of a frame's window, B the frame's pose by its keys, J the joints by
    the pose. Shape and detector bias are taken as known.

    Args:
        model: what the keys were judged by.
        layout: windows of the keys.
        keys: the solution.
        frames: the poses of all frames of the layout.
        system: normal equations at the solution.
        inflation: factor on the variance that the noise's correlation in time demands.
    """
    xp = array_namespace(keys.z)
    diagonal, upper = system.marginals()
    dof = diagonal.shape[-1] // 2
    tangents = key_tangents(model.prior, keys, residuals=model.residuals)
    landmarks = keypoint_landmarks(model.subject.body, JointSet.SMPL_24)
    window, time = layout.positions(layout.frames)
    shares = lagrange(constant(time, keys.z))

    def block(w: int) -> Array:
        index = np.flatnonzero(window == w)
        poses = select_frames(frames, index)
        posed = pose_landmarks(
            model.subject.body, landmarks, model.subject.betas, poses.root, poses.local, poses.transl, jacobian=True
        )
        eye = xp.eye(3, dtype=keys.z.dtype, device=getattr(keys.z, "device", None))
        J = xp.concat([posed.by_rotations, xp.broadcast_to(eye, (*posed.points.shape[:2], 3, 3))], axis=-1)
        J = xp.reshape(J, (len(index), -1, J.shape[-1]))
        S = _window_covariance(xp, diagonal, upper, w, dof)
        parts = [s[index][:, None, None] * xp.matmul(J, tangents[2 * w + k]) for k, s in enumerate(shares)]
        flat = xp.reshape(xp.concat(parts, axis=-1), (-1, 3 * dof))
        by_joint = (len(index), -1, 3, 3 * dof)
        spread = xp.reshape(xp.matmul(flat, S), by_joint)
        return inflation * xp.matmul(spread, xp.matrix_transpose(xp.reshape(flat, by_joint)))

    return xp.concat(map_blocks(block, range(layout.num_windows), keys.z))


def joint_sigma(covariance: Array) -> Array:
    """Return (F, 24) standard deviations in metres, the root mean square over the axes of (F, 24, 3, 3)."""
    xp = array_namespace(covariance)
    return xp.sqrt(xp.linalg.trace(covariance) / 3)


def _window_covariance(xp, diagonal: Array, upper: Array, w: int, dof: int) -> Array:
    """Return the (3 D, 3 D) covariance of a window's keys: block w and the first key of block w + 1."""
    across = upper[w][:, :dof]
    top = xp.concat([diagonal[w], across], axis=1)
    bottom = xp.concat([across.T, diagonal[w + 1][:dof, :dof]], axis=1)
    return xp.concat([top, bottom])


def noise_inflation(
    subject: Subject, frames: PosedFrames, term: ReprojectionTerm, scale: float, num_frames: int
) -> float:
    """Return how much less n neighbouring frames tell than n independent ones: ``1 + 2 sum_k (1 - k/n) r^k``.

    A detector errs alike in neighbouring frames. r, the lag-one correlation of first-order autoregressive noise, is
    measured on the reprojection residuals of inliers; n is the number of frames that a key averages over.

    Reference: Bayley and Hammersley 1946, "The effective number of independent observations in an autocorrelated
    series".
    """
    points = pose(subject, frames).points
    xp = array_namespace(points)
    error, inlier = term.residuals(points, scale)
    pair = xp.astype(inlier[:, 1:] & inlier[:, :-1], error.dtype)
    product = xp.sum(xp.sum(error[:, 1:] * error[:, :-1], axis=-1) * pair)
    power = xp.sum(0.5 * xp.sum(error[:, 1:] ** 2 + error[:, :-1] ** 2, axis=-1) * pair)
    r = float(np.clip(float(product) / max(float(power), 1e-12), 0.0, 0.95))
    lag = np.arange(1, num_frames)
    return float(1 + 2 * ((1 - lag / num_frames) * r**lag).sum())
