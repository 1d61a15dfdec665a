"""Projection matrices 3 x 4, and the eleven numbers of the direct linear transformation, as cameras."""

from __future__ import annotations

import numpy as np

from solver_backend.exchange.errors import CalibrationInvalid

DLT_NUMBERS = 11
"""Of a camera: the projection matrix by rows, divided by its last element."""
_SMALLEST_VOLUME = 1e-6
"""Of the directions of the three rows: a camera's is fx fy over their lengths, above 0.01 for any lens."""


def split_projection(P: np.ndarray, place: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return K (3, 3), R (3, 3) and t (3,) of ``P = s K [R | t]``, K with a positive diagonal and a last element of 1.

    The left block is a triangular matrix times a rotation: its RQ factors, from the QR factors of its inverse (Hartley
    and Zisserman 2004, "Multiple View Geometry", section 6.2.4). Skew is left out; it is 0 in real cameras.

    Args:
        P: (3, 4) in pixels, of any scale and sign.
        place: file and camera, for errors.

    Raises:
        CalibrationInvalid: it is no projection of a camera.
    """
    if P.shape != (3, 4) or not np.isfinite(P).all() or not _is_regular(P[:, :3]):
        raise CalibrationInvalid("The projection matrix is not that of a camera.", where=place)
    M = P[:, :3]
    if np.linalg.det(M) < 0:
        P, M = -P, -M
    Q, U = np.linalg.qr(np.linalg.inv(M))
    signs = np.where(np.diag(U) < 0, -1.0, 1.0)
    R, K = (Q * signs).T, np.linalg.inv(signs[:, None] * U)
    t = np.linalg.solve(K, P[:, 3])
    K = K / K[2, 2]
    K[0, 1] = 0.0
    return K, R, t


def _is_regular(M: np.ndarray) -> bool:
    """Whether the rows of a matrix point in three directions."""
    length = np.linalg.norm(M, axis=1)
    return bool((length > 0).all()) and abs(np.linalg.det(M / length[:, None])) > _SMALLEST_VOLUME


def projection_of(dlt: np.ndarray) -> np.ndarray:
    """Return the (3, 4) projection matrix of eleven DLT numbers (Abdel-Aziz and Karara 1971)."""
    return np.append(dlt, 1.0).reshape(3, 4)
