"""A flat board's pose and a camera's focal length from homographies, where a bundle adjustment starts."""

from __future__ import annotations

import numpy as np

from solver_backend.geometry.alignment import nearest_rotation
from solver_backend.types.shapes import Float


def homography(plane: Float[np.ndarray, "n 2"], image: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "3 3"]:
    """Return the matrix H with ``image ~ H plane`` by the normalised direct linear transform.

    Args:
        plane: (n, 2) points on the board, n at least 4.
        image: (n, 2) the same in a picture.

    Reference: Hartley and Zisserman 2004, "Multiple View Geometry", algorithm 4.2.
    """
    (a, A), (b, B) = _centred(plane), _centred(image)
    one, none = np.ones((len(a), 1)), np.zeros((len(a), 3))
    h = np.concatenate([a, one], axis=1)
    rows = np.concatenate([np.hstack([h, none, -b[:, :1] * h]), np.hstack([none, h, -b[:, 1:] * h])])
    H = np.linalg.svd(rows)[2][-1].reshape(3, 3)
    return np.linalg.inv(B) @ H @ A


def focal_from_homographies(
    homographies: Float[np.ndarray, "views 3 3"], centre: Float[np.ndarray, " 2"]
) -> float | None:
    """Return the focal length in px that makes the boards' axes orthogonal and equally long, None where none does.

    With the centre known, ``ω = diag(1/f², 1/f², 1)``: ``h1ᵀ ω h2 = 0`` and ``h1ᵀ ω h1 = h2ᵀ ω h2``.

    Args:
        homographies: (V, 3, 3) board to picture.
        centre: (2,) px, the principal point.

    Reference: Zhang 2000, "A flexible new technique for camera calibration", eqs. 3 and 4.
    """
    shift = np.array([[1, 0, -centre[0]], [0, 1, -centre[1]], [0, 0, 1.0]])
    H = shift @ homographies
    H = H / np.linalg.norm(H[:, :, :2], axis=(1, 2), keepdims=True)
    a, b = H[:, :, 0], H[:, :, 1]
    left = np.concatenate([(a * b)[:, :2].sum(-1), (a**2 - b**2)[:, :2].sum(-1)])
    right = -np.concatenate([(a * b)[:, 2], a[:, 2] ** 2 - b[:, 2] ** 2])
    inverse_square = float(left @ right) / max(float(left @ left), 1e-30)
    return float(inverse_square**-0.5) if inverse_square > 1e-12 else None


def planar_pose(
    plane: Float[np.ndarray, "n 2"], normalised: Float[np.ndarray, "n 2"]
) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, " 3"]]:
    """Return the rotation and translation board to camera from undistorted normalised coordinates.

    Reference: Zhang 2000, sec. 3.1.
    """
    H = homography(plane, normalised)
    H = H / np.sqrt(np.linalg.norm(H[:, 0]) * np.linalg.norm(H[:, 1]))
    if H[2, 2] < 0:
        H = -H
    R = nearest_rotation(np.stack([H[:, 0], H[:, 1], np.cross(H[:, 0], H[:, 1])], axis=-1))
    return np.asarray(R), H[:, 2]


def _centred(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return points about their mean at a mean distance of √2, and the (3, 3) matrix that brings them there."""
    mean = points.mean(0)
    scale = np.sqrt(2.0) / max(float(np.linalg.norm(points - mean, axis=1).mean()), 1e-12)
    return (points - mean) * scale, np.array([[scale, 0, -scale * mean[0]], [0, scale, -scale * mean[1]], [0, 0, 1.0]])
