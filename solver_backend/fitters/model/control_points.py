"""From the parabolas that were solved to one curve of continuous acceleration: control points of a cubic spline."""

from __future__ import annotations

import numpy as np

from solver_backend.fitters.model.interpolant import lagrange
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout, WindowRows
from solver_backend.fitters.model.keyframes import Keyframes
from solver_backend.geometry.arrays import constant, to_numpy

_STEPS = 60
"""Steps of conjugate gradients at most; chosen by hand."""
_TOLERANCE = 1e-10
"""Residual against the right-hand side at which the steps end; chosen by hand."""


def control_points(keys: Keyframes, layout: KeyframeLayout) -> Keyframes:
    """Return as many control points, whose spline lies nearest to the parabolas through the keys.

    ``argmin_c Σ_f |Σ_k B_k(f) c_k - Σ_k w_k(f) x_k|²`` over the frames f, with cubic B-splines B (see
    ``KeyframeLayout.spline_shares``) and Lagrange's w; neighbouring keys lie close together, so codes and quaternions
    are taken as points of space. Control points are off the spheres that the spline's points are brought back to.

    Args:
        keys: 2 N + 1 keys, solved on the parabolas of N windows.
        layout: of these windows.
    """
    given = [to_numpy(part) for part in (keys.z, keys.quat, keys.transl, keys.residual)]
    flat = np.concatenate([part.reshape(len(part), -1) for part in given], axis=1)
    found = _spline(flat, layout)[0]
    ends = np.cumsum([part[0].size for part in given])
    parts = [part.reshape(like.shape) for part, like in zip(np.split(found, ends[:-1], axis=1), given, strict=True)]
    return Keyframes(*(constant(part, keys.z) for part in parts))


def spline_states(keys: np.ndarray, layout: KeyframeLayout) -> np.ndarray:
    """Return (F, d) numbers of all frames on that spline, of numbers (K, d) that are no points of a sphere."""
    points, rows, shares = _spline(keys, layout)
    padded = np.pad(points, ((1, 1), (0, 0)))
    fives = np.stack([padded[i : len(padded) - 4 + i : 2] for i in range(5)], axis=1)
    states = (shares @ fives).reshape(-1, keys.shape[1])
    return states[rows.weight.reshape(-1) > 0]


def _spline(flat: np.ndarray, layout: KeyframeLayout) -> tuple[np.ndarray, WindowRows, np.ndarray]:
    """Return (K, d) control points, and the windows' frames with the weights of these points."""
    rows = layout.rows()
    shares = layout.spline_shares(np.arange(layout.num_windows)[:, None] + 0 * rows.frames, rows.time)
    return _nearest(flat, rows, shares), rows, shares


def _nearest(flat: np.ndarray, rows: WindowRows, shares: np.ndarray) -> np.ndarray:
    """Return (K, d) control points, by conjugate gradients from the keys (Hestenes and Stiefel 1952).

    What the frames do not determine, where keys are denser than they, stays as the keys have it.
    """
    weighted_T = np.swapaxes(shares * (rows.weight > 0)[..., None], 1, 2)
    normal = weighted_T @ shares
    triples = np.stack([flat[i : len(flat) - 2 + i : 2] for i in range(3)], axis=1)
    x = np.pad(flat, ((1, 1), (0, 0)))
    error = _summed(weighted_T @ (lagrange(rows.time) @ triples)) - _applied(normal, x)
    direction, square = error, (error * error).sum(axis=0)
    enough = _TOLERANCE**2 * np.maximum(square, 1e-30)
    for _ in range(_STEPS):
        going = square > enough
        if not going.any():
            break
        along = _applied(normal, direction)
        step = np.where(going, square / np.maximum((direction * along).sum(axis=0), 1e-300), 0.0)
        x, error = x + step * direction, error - step * along
        former, square = square, (error * error).sum(axis=0)
        direction = error + square / np.maximum(former, 1e-300) * direction
    return x[1:-1]


def _applied(normal: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return the (N, 5, 5) matrices of the windows applied to (2 N + 3, d) points, one more at either end."""
    fives = np.stack([x[i : len(x) - 4 + i : 2] for i in range(5)], axis=1)
    return _summed(normal @ fives)


def _summed(by_keys: np.ndarray) -> np.ndarray:
    """Return (2 N + 3, d): (N, 5, d) summed where windows share a key."""
    count = len(by_keys)
    summed = np.zeros((2 * count + 3, by_keys.shape[-1]))
    for k in range(5):
        summed[k : k + 2 * count - 1 : 2] += by_keys[:, k]
    return summed
