"""Posterior covariance of the keyframes, carried to the joints of every frame."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from solver_backend.body.keypoints import joint_landmarks
from solver_backend.body.landmarks import pose_landmarks
from solver_backend.fitters.keyframes.normal_equations import BLOCK_FRAMES
from solver_backend.fitters.keyframes.optimise import CHUNK_WINDOWS, OVERLAP_WINDOWS, BundleModel, chunks_of
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout, lagrange
from solver_backend.fitters.model.subject import BLOCK_POSES, Keyframes, PosedFrames, d_pose_d_key
from solver_backend.geometry.arrays import Array, array_namespace, constant, identity, index
from solver_backend.geometry.parallel import block_size, map_blocks
from solver_backend.geometry.small_matrices import packed
from solver_backend.residuals.terms import DataTerm
from solver_backend.solver.block_tridiagonal import BlockTridiagonal

CALIBRATION = 0.5
"""Share of the inflated posterior variance that is kept: constant errors inflate it too. Calibrated so that the
ellipsoids of six benchmark takes have the right coverage."""


def joint_covariance(
    model: BundleModel,
    layout: KeyframeLayout,
    keys: Keyframes,
    frames: PosedFrames,
    system: BlockTridiagonal,
    inflation: float,
    constant_m: np.ndarray,
    stride: int = 1,
) -> Array:
    """Return (F, J, 3, 3) posterior covariances of the joints in square metres: ``k f J B S Bᵀ Jᵀ + c² I``.

    S is the posterior covariance of the three keys of a frame's window, B the pose by its keys (the keys' own pose
    tangents mixed by Lagrange's weights), J the joints by the pose, f the inflation, k ``CALIBRATION``, c the constant.

    Args:
        system: normal equations at the solution.
        inflation: variance factor for noise correlated in time.
        constant_m: (J,) standard deviation per axis of errors that do not average out, metres.
        stride: form the covariance of every n-th frame and interpolate linearly.
    """
    xp = array_namespace(keys.z)
    diagonal, upper = system.marginals()
    residual = keys.residual if model.free.turned else None
    d_pose_d_keys = xp.astype(d_pose_d_key(model.free, model.prior, keys.z, residual), diagonal.dtype)
    landmarks = joint_landmarks(model.subject.body, model.subject.body.layout.recorded)
    constant_m2 = constant(constant_m**2, keys.z)[:, None, None] * identity(3, keys.z)
    rows = layout.rows(stride)

    def block(windows: slice) -> Array:
        part = rows.select(windows)
        poses = frames.select(part.frames[part.weight > 0] - layout.bounds[0])
        body, betas = model.subject.body, model.subject.betas
        posed = pose_landmarks(
            body, landmarks, betas, poses.root, poses.local, poses.transl, jacobian=True, by_shape=False
        )
        of_keys = _pose_covariance(diagonal, upper, d_pose_d_keys, windows)
        shares = lagrange(constant(part.time, d_pose_d_keys))
        mixes = xp.reshape(shares[..., :, None] * shares[..., None, :], (*part.time.shape, 9))
        mixed = xp.matmul(mixes, xp.reshape(of_keys, (of_keys.shape[0], 9, -1)))
        used = index(np.flatnonzero(part.weight > 0), keys.z)
        mixed = xp.reshape(mixed, (-1, poses.layout.dof, poses.layout.dof))[used]
        eye = identity(3, d_pose_d_keys)
        by_rotations = xp.astype(posed.by_rotations, d_pose_d_keys.dtype)
        J = xp.concat([by_rotations, xp.broadcast_to(eye, (*posed.points.shape[:2], 3, 3))], axis=-1)
        carried = xp.reshape(xp.matmul(xp.reshape(J, (J.shape[0], -1, poses.layout.dof)), mixed), J.shape)
        spread = xp.astype(xp.matmul(carried, xp.matrix_transpose(J)), keys.z.dtype)
        return CALIBRATION * inflation * spread + constant_m2

    found = xp.concat(map_blocks(block, rows.blocks(block_size(BLOCK_FRAMES, keys.z)), keys.z))
    return found if stride == 1 else _between(found, rows.frames[rows.weight > 0], layout.frames)


def covariance_of_joints(
    model: BundleModel,
    layout: KeyframeLayout,
    keys: Keyframes,
    frames: PosedFrames,
    scale: float,
    inflation: float,
    constant_m: np.ndarray,
    chunk_windows: int = CHUNK_WINDOWS,
    overlap: int = OVERLAP_WINDOWS,
    stride: int = 1,
    done: Callable[[int, int], None] = lambda number, total: None,
) -> Array:
    """Return (F, 24, 6) covariances of the joints, see ``joint_covariance`` and ``packed``, chunk after chunk.

    ``done`` is called with the number of finished chunks and of all chunks.
    """
    first, found = layout.bounds[0], []
    chunks = chunks_of(layout.num_windows, overlap, chunk_windows, overlap)
    for chunk in chunks:
        windows, some = layout.part(chunk.solved), keys.select(chunk.keys)
        part = model.part(chunk.keys)
        system = part.information(windows, some, scale).block_tridiagonal()
        poses = frames.select(index(windows.frames - first, keys.z))
        spread = packed(joint_covariance(model, windows, some, poses, system, inflation, constant_m, stride))
        low, high = layout.bounds[chunk.kept.start] + (chunk.kept.start > 0), layout.bounds[chunk.kept.stop]
        found.append(spread[low - windows.bounds[0] : high + 1 - windows.bounds[0]])
        done(len(found), len(chunks))
    return array_namespace(keys.z).concat(found)


def _between(found: Array, frames: np.ndarray, wanted: np.ndarray) -> Array:
    """Return (F, ...) values of the wanted frames, interpolated linearly and held constant beyond the ends."""
    after = np.clip(np.searchsorted(frames, wanted), 1, max(1, len(frames) - 1))
    before, after = after - 1, np.minimum(after, len(frames) - 1)
    share = np.clip((wanted - frames[before]) / np.maximum(frames[after] - frames[before], 1), 0.0, 1.0)
    t = constant(share, found)[:, None, None, None]
    return (1 - t) * found[index(before, found)] + t * found[index(after, found)]


def _pose_covariance(diagonal: Array, upper: Array, d_pose_d_keys: Array, windows: slice) -> Array:
    """Return (N, 3, 3, p, p): ``P_a S_ab P_bᵀ``, covariances of the pose tangents at the three keys of windows."""
    xp = array_namespace(d_pose_d_keys)
    dof = d_pose_d_keys.shape[-1]
    start, after = slice(windows.start, windows.stop), slice(windows.start + 1, windows.stop + 1)
    across = upper[start][:, :, :dof]
    top = xp.concat([diagonal[start], across], axis=2)
    bottom = xp.concat([xp.matrix_transpose(across), diagonal[after][:, :dof, :dof]], axis=2)
    S = xp.concat([top, bottom], axis=1)
    P = [d_pose_d_keys[2 * windows.start + k : 2 * windows.stop + k : 2] for k in range(3)]
    halves = [xp.matmul(P[k], S[:, k * dof : (k + 1) * dof]) for k in range(3)]
    P_T = [xp.matrix_transpose(part) for part in P]
    parts = [xp.matmul(half[:, :, k * dof : (k + 1) * dof], P_T[k]) for half in halves for k in range(3)]
    return xp.reshape(xp.stack(parts, axis=1), (-1, 3, 3, *d_pose_d_keys.shape[1:2] * 2))


def noise_inflation(points: Array, term: DataTerm, scale: float, num_frames: int) -> float:
    """Return the variance factor of the mean over n correlated frames: ``1 + 2 sum_k (1 - k/n) r^k``.

    r is the lag-one correlation of first-order autoregressive noise, measured on the residuals of inliers.

    Args:
        points: (F, L, 3) landmarks of a solution.
        num_frames: n, the number of frames that a key averages over.

    Reference: Bayley and Hammersley 1946, "The effective number of independent observations in an autocorrelated
    series".
    """
    xp, count = array_namespace(points), points.shape[0]
    product = power = 0.0
    for start in range(0, count, BLOCK_POSES):
        part = np.arange(start, min(start + BLOCK_POSES + 1, count))
        found = term.select(part).residuals(points[start : start + len(part)])
        error, inlier = found.error, found.inliers(scale)
        pair = xp.astype(inlier[:, 1:] & inlier[:, :-1], error.dtype)
        product += float(xp.sum(xp.sum(error[:, 1:] * error[:, :-1], axis=-1) * pair))
        power += float(xp.sum(0.5 * xp.sum(error[:, 1:] ** 2 + error[:, :-1] ** 2, axis=-1) * pair))
    r = float(np.clip(product / max(power, 1e-12), 0.0, 0.95))
    lag = np.arange(1, num_frames)
    return float(1 + 2 * ((1 - lag / num_frames) * r**lag).sum())
