"""Limbs: two bones and a hinge brought to where hand and foot belong, for all frames at once."""

from __future__ import annotations

import numpy as np

from ..._exchange.so3 import matrix_from_rotvec

_STRAIGHTEST = 0.9995
"""Share of a limb's length that it is stretched to at most, unless the actor's is straighter."""
_CLEAR_BEND = 0.05
"""Sine of the bend at which the plane of the bones and the anatomical axis count alike."""


def bend_to(reach: np.ndarray, upper: np.ndarray, lower: np.ndarray, axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return how the two bones of a limb turn so that it ends where it should; twist and plane stay the actor's.

    First the lower bone turns about the hinge n until the distance d is right, with u and v the bones, a bar for the
    part square to n and the law of cosines: ``|ū| |v̄| cos φ = (d² - |u|² - |v|²)/2 - (u·n)(v·n)``. Then the
    whole limb swings by the smallest rotation.

    Args:
        reach: (F, 3) from the limb's beginning to where it should end; shortened if it is longer than the limb.
        upper: (F, 3) the upper bone as the actor has it, with the rig's length.
        lower: (F, 3) the lower bone.
        axis: (F, 3) unit vectors, the anatomical axis of the hinge, about which it bends by positive angles.

    Returns:
        (F, 3, 3) rotations to apply after those of the upper and of the lower bone.
    """
    a, b = np.linalg.norm(upper, axis=-1), np.linalg.norm(lower, axis=-1)
    distance = np.clip(np.linalg.norm(reach, axis=-1), 1.001 * np.abs(a - b), longest_reach(upper, lower))
    n = bend_axis(upper, lower, axis)
    un, vn = _dot(upper, n), _dot(lower, n)
    u, v = upper - un[:, None] * n, lower - vn[:, None] * n
    lengths = np.maximum(np.linalg.norm(u, axis=-1) * np.linalg.norm(v, axis=-1), 1e-12)
    cosine = ((distance**2 - a**2 - b**2) / 2 - un * vn) / lengths
    now = np.arctan2(_dot(np.cross(u, v), n), _dot(u, v))
    bend = matrix_from_rotvec((np.arccos(np.clip(cosine, -1.0, 1.0)) - now)[:, None] * n)
    whole = swing(upper + (bend @ lower[..., None])[..., 0], reach)
    return whole, whole @ bend


def longest_reach(upper: np.ndarray, lower: np.ndarray) -> np.ndarray:
    """Return how far a limb reaches at most, as long as the actor's bones lie: (..., 3) each, to (...)."""
    a, b = np.linalg.norm(upper, axis=-1), np.linalg.norm(lower, axis=-1)
    return np.maximum(_STRAIGHTEST * (a + b), np.linalg.norm(upper + lower, axis=-1))


def bend_axis(upper: np.ndarray, lower: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Return the unit vectors (F, 3) about which two bones are bent: square to both, the anatomical axis if straight.

    ``n ∝ u × v / (|u| |v|) + ε a``, so that it neither jumps nor flips as a limb stretches.

    Args:
        upper: (F, 3) the upper bone.
        lower: (F, 3) the lower bone.
        axis: (F, 3) unit vectors, the anatomical axis.
    """
    along = _unit(upper + lower)
    square = _unit(axis - _dot(axis, along)[:, None] * along)
    n = np.cross(_unit(upper), _unit(lower)) + _CLEAR_BEND * square
    return np.where(np.linalg.norm(n, axis=-1, keepdims=True) > 0.4 * _CLEAR_BEND, _unit(n), square)


def swing(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the smallest rotations (F, 3, 3) from directions (F, 3) to others."""
    a, b = _unit(a), _unit(b)
    axis = np.cross(a, b)
    sine = np.linalg.norm(axis, axis=-1, keepdims=True)
    angle = np.arctan2(sine, _dot(a, b)[:, None])
    return matrix_from_rotvec(axis * np.where(sine > 1e-9, angle / np.maximum(sine, 1e-9), 0.0))


def within_reach(hips: np.ndarray, ankles: np.ndarray, reaches: np.ndarray, rounds: int = 12) -> np.ndarray:
    """Return the least way (F, 3) by which the body must move for every leg to reach its foot.

    Each leg asks the hips into a ball around its foot; alternating projections onto the balls end in both (Bregman
    1965).

    Args:
        hips: (L, F, 3) where the legs begin.
        ankles: (L, F, 3) where they should end.
        reaches: (L, F) how far each leg reaches.
        rounds: how often each leg asks.
    """
    way = np.zeros(hips.shape[1:])
    for _ in range(rounds):
        for hip, ankle, reach in zip(hips, ankles, reaches, strict=True):
            apart = ankle - hip - way
            distance = np.linalg.norm(apart, axis=-1, keepdims=True)
            way += apart * np.maximum(1.0 - reach[:, None] / np.maximum(distance, 1e-9), 0.0)
    return way


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-12)


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return (a * b).sum(-1)
