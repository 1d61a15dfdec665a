"""Convert rotations with NumPy, for baking and files. Quaternions are wxyz."""

from __future__ import annotations

import numpy as np


def quat_from_rotvec(rotvec: np.ndarray) -> np.ndarray:
    """Convert rotation vectors (..., 3) to quaternions wxyz (..., 4)."""
    half = np.linalg.norm(rotvec, axis=-1, keepdims=True) / 2
    # np.sinc(x) = sin(pi x) / (pi x), so the vector part is finite at angle 0.
    return np.concatenate([np.cos(half), np.sinc(half / np.pi) / 2 * rotvec], axis=-1)


def rotvec_from_quat(quat: np.ndarray) -> np.ndarray:
    """Convert quaternions to rotation vectors (..., 3) with lengths from 0 to pi.

    Args:
        quat: (..., 4) unit quaternions wxyz of either sign.
    """
    quat = np.where(quat[..., :1] < 0, -quat, quat)
    length = np.linalg.norm(quat[..., 1:], axis=-1, keepdims=True)
    angle = 2 * np.arctan2(length, quat[..., :1])
    return np.where(length > 1e-12, angle / np.maximum(length, 1e-12), 2.0) * quat[..., 1:]


def quat_multiply(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the Hamilton product a b (..., 4) wxyz, which rotates by b first."""
    aw, av, bw, bv = a[..., :1], a[..., 1:], b[..., :1], b[..., 1:]
    w = aw * bw - (av * bv).sum(-1, keepdims=True)
    return np.concatenate([w, aw * bv + bw * av + np.cross(av, bv)], axis=-1)


def matrix_from_rotvec(rotvec: np.ndarray) -> np.ndarray:
    """Convert rotation vectors (..., 3) to matrices by Rodrigues' formula."""
    angle = np.linalg.norm(rotvec, axis=-1)[..., None, None]
    x, y, z = np.moveaxis(np.asarray(rotvec, np.float64), -1, 0)
    o = np.zeros_like(x)
    K = np.stack([np.stack([o, -z, y], -1), np.stack([z, o, -x], -1), np.stack([-y, x, o], -1)], -2)
    return np.eye(3) + np.sinc(angle / np.pi) * K + np.sinc(angle / 2 / np.pi) ** 2 / 2 * (K @ K)


def matrix_from_quat(quat: np.ndarray) -> np.ndarray:
    """Convert unit quaternions (..., 4) wxyz to rotation matrices (..., 3, 3)."""
    w, x, y, z = np.moveaxis(quat, -1, 0)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, -1) for row in rows], -2)


def quat_from_matrix(R: np.ndarray) -> np.ndarray:
    """Convert rotation matrices (..., 3, 3) to unit quaternions (..., 4) wxyz with w >= 0.

    Each quaternion is the longest column of ``4 q q^T``, which is numerically stable at every angle (Shepperd 1978).
    """
    m00, m11, m22 = R[..., 0, 0], R[..., 1, 1], R[..., 2, 2]
    outer = np.empty((*R.shape[:-2], 4, 4))
    outer[..., range(4), range(4)] = np.stack(
        [1 + m00 + m11 + m22, 1 + m00 - m11 - m22, 1 - m00 + m11 - m22, 1 - m00 - m11 + m22], axis=-1
    )
    for a, b, c in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        outer[..., 0, 1 + a] = outer[..., 1 + a, 0] = R[..., c, b] - R[..., b, c]
        outer[..., 1 + a, 1 + b] = outer[..., 1 + b, 1 + a] = R[..., a, b] + R[..., b, a]
    longest = outer[..., range(4), range(4)].argmax(-1)[..., None, None]
    quat = np.take_along_axis(outer, longest, axis=-1)[..., 0]
    return quat * np.where(quat[..., :1] < 0, -1.0, 1.0) / np.linalg.norm(quat, axis=-1, keepdims=True)


def rotvec_from_matrix(R: np.ndarray) -> np.ndarray:
    """Convert rotation matrices (..., 3, 3) to rotation vectors (..., 3) with lengths up to pi."""
    return rotvec_from_quat(quat_from_matrix(R))


def sign_continuous(quat: np.ndarray) -> np.ndarray:
    """Choose the signs of (F, ..., 4) quaternions so that neighbours have ``q · q' >= 0``.

    q and -q are the same rotation, but an interpolation from one to the other passes through zero.
    """
    flip = np.ones(quat.shape[:-1])
    flip[0] = np.where(quat[0, ..., 0] < 0, -1.0, 1.0)
    flip[1:] = np.where((quat[1:] * quat[:-1]).sum(-1) < 0, -1.0, 1.0)
    return quat * np.cumprod(flip, axis=0)[..., None]
