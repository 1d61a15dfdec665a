"""How sure the solve is of each joint: the posterior of the keyframes, carried to the joints of every frame."""

from __future__ import annotations

import numpy as np
from array_api_compat import array_namespace

from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.body.landmarks import pose_landmarks
from solver_backend.fitters.keyframes import BundleFrames, KeyframeLayout
from solver_backend.fitters.subject import Subject, pose
from solver_backend.geometry.arrays import Array
from solver_backend.residuals.reprojection import ReprojectionTerm
from solver_backend.solver.normal_equations import BlockTridiagonal
from solver_backend.types import JointSet


def joint_sigma(
    subject: Subject, frames: BundleFrames, layout: KeyframeLayout, system: BlockTridiagonal, inflation: float
) -> Array:
    """Return (F, 24) standard deviations of the joints in metres: ``sqrt(tr(J B S Bᵀ Jᵀ) / 3)``.

    S is the posterior covariance of the three keys of a frame's window, B the frame's pose by its keys, J the joints by
    the pose. Shape and detector bias are taken as known.

    Args:
        subject: the person.
        frames: frames at the solution, with derivatives.
        layout: windows of the keys.
        system: normal equations at the solution.
        inflation: factor on the variance that the noise's correlation in time demands.
    """
    assert frames.by_keys is not None
    xp = array_namespace(frames.by_keys)
    diagonal, upper = system.marginals()
    dof = diagonal.shape[-1] // 2
    poses = frames.poses
    posed = pose_landmarks(
        subject.body, keypoint_landmarks(subject.body, JointSet.SMPL_24), subject.betas,
        poses.root, poses.local, poses.transl, jacobian=True,
    )  # fmt: skip
    eye = xp.eye(3, dtype=posed.points.dtype, device=getattr(posed.points, "device", None))
    J = xp.concat([posed.by_rotations, xp.broadcast_to(eye, (*posed.points.shape[:2], 3, 3))], axis=-1)
    sigmas = []
    for w in range(layout.num_windows):
        index = layout.slice_of(w)
        S = _window_covariance(xp, diagonal, upper, w, dof)
        by_keys = xp.matmul(xp.reshape(J[index], (-1, 72, J.shape[-1])), frames.by_keys[index])
        variance = xp.sum(xp.matmul(by_keys, S) * by_keys, axis=-1)
        sigmas.append(xp.sqrt(inflation * xp.mean(xp.reshape(variance, (-1, 24, 3)), axis=-1)))
    return xp.concat(sigmas)


def _window_covariance(xp, diagonal: Array, upper: Array, w: int, dof: int) -> Array:
    """Return the (3 D, 3 D) covariance of a window's keys: block w and the first key of block w + 1."""
    across = upper[w][:, :dof]
    top = xp.concat([diagonal[w], across], axis=1)
    bottom = xp.concat([across.T, diagonal[w + 1][:dof, :dof]], axis=1)
    return xp.concat([top, bottom])


def noise_inflation(
    subject: Subject, frames: BundleFrames, term: ReprojectionTerm, scale: float, num_frames: int
) -> float:
    """Return how much less n neighbouring frames tell than n independent ones: ``1 + 2 sum_k (1 - k/n) r^k``.

    A detector errs alike in neighbouring frames. r, the lag-one correlation of first-order autoregressive noise, is
    measured on the reprojection residuals of inliers; n is the number of frames that a key averages over.

    Reference: Bayley and Hammersley 1946, "The effective number of independent observations in an autocorrelated
    series".
    """
    points = pose(subject, frames.poses).points
    xp = array_namespace(points)
    error, inlier = term.residuals(points, scale)
    pair = xp.astype(inlier[:, 1:] & inlier[:, :-1], error.dtype)
    product = xp.sum(xp.sum(error[:, 1:] * error[:, :-1], axis=-1) * pair)
    power = xp.sum(0.5 * xp.sum(error[:, 1:] ** 2 + error[:, :-1] ** 2, axis=-1) * pair)
    r = float(np.clip(float(product) / max(float(power), 1e-12), 0.0, 0.95))
    lag = np.arange(1, num_frames)
    return float(1 + 2 * ((1 - lag / num_frames) * r**lag).sum())
