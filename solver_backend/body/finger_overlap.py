"""Fingers that run through one another: how deep two capsules about their bones overlap."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.types.shapes import Float

RADIUS_M = (0.009, 0.0085, 0.0085, 0.008, 0.007)
"""Half the breadth of thumb, index, middle, ring and little finger at the last joint, of a hand of ``PALM_M`` (Garrett
1971, "The adult human hand", means of men and women)."""
PALM_M = 0.09
"""From the wrist to the middle finger's knuckle, of the hand with these breadths."""
BONES = np.array([[4 * finger + k, 4 * finger + k + 1] for finger in range(5) for k in range(1, 4)])
"""Ends of the three bones of each finger beyond its knuckle, in ``HAND_POINTS``."""
_ONE, _OTHER = (pair for pair in np.triu_indices(len(BONES)))
_APART = _ONE // 3 != _OTHER // 3
PAIRS = np.stack([_ONE[_APART], _OTHER[_APART]])
"""(2, 90) bones of different fingers."""


@dataclass(frozen=True)
class FingerGaps:
    """Bones of different fingers over F frames, P pairs."""

    depth: Float[np.ndarray, "frames pairs"]
    """(F, P) metres by which two bones overlap; negative where they are apart."""
    along: Float[np.ndarray, "frames pairs 2"]
    """(F, P, 2) where they are nearest, as a share of each bone."""
    apart: Float[np.ndarray, "frames pairs 3"]
    """(F, P, 3) metres from there on the second bone to there on the first."""


def finger_gaps(points: Float[np.ndarray, "frames 21 3"]) -> FingerGaps:
    """Return how far bones of different fingers overlap: ``r_a + r_b - d`` of capsules about them.

    Args:
        points: (F, 21, 3) metres of ``HAND_POINTS``.
    """
    radius = np.repeat(RADIUS_M, 3)
    palm = np.linalg.norm(points[:, 9] - points[:, 0], axis=-1)[:, None]
    (a, b), (c, d) = (np.moveaxis(points[:, BONES[bones]], 2, 0) for bones in PAIRS)
    along, apart = nearest_points(a, b, c, d)
    reach = (radius[PAIRS[0]] + radius[PAIRS[1]]) * palm / PALM_M
    return FingerGaps(reach - np.linalg.norm(apart, axis=-1), along, apart)


def finger_overlap(points: Float[np.ndarray, "frames 21 3"]) -> Float[np.ndarray, " frames"]:
    """Return (F,) metres by which the two fingers that overlap most do, 0 where none does."""
    return np.maximum(finger_gaps(points).depth.max(axis=1), 0.0)


def nearest_points(
    a: Float[np.ndarray, "*batch 3"], b: Float[np.ndarray, "*batch 3"], c: Float[np.ndarray, "*batch 3"],
    d: Float[np.ndarray, "*batch 3"],
) -> tuple[Float[np.ndarray, "*batch 2"], Float[np.ndarray, "*batch 3"]]:  # fmt: skip
    """Return where segments a-b and c-d are nearest, as shares of each, and the vector from the second to the first.

    Reference: Ericson 2004, "Real-Time Collision Detection", section 5.1.9.
    """
    u, v, w = b - a, d - c, a - c
    uu, vv = np.maximum((u * u).sum(-1), 1e-12), np.maximum((v * v).sum(-1), 1e-12)
    uv, uw, vw = (u * v).sum(-1), (u * w).sum(-1), (v * w).sum(-1)
    denominator = uu * vv - uv**2
    s = np.where(denominator > 1e-9 * uu * vv, (uv * vw - uw * vv) / np.maximum(denominator, 1e-18), 0.0)
    t = np.clip((np.clip(s, 0.0, 1.0) * uv + vw) / vv, 0.0, 1.0)
    s = np.clip((t * uv - uw) / uu, 0.0, 1.0)
    return np.stack([s, t], axis=-1), w + s[..., None] * u - t[..., None] * v
