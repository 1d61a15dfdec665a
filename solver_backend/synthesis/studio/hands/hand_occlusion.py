"""Which points of hands other fingers and palms hide: bones as capsules before the lines of sight."""

from __future__ import annotations

import numpy as np

from solver_backend.exchange.hand_points import HAND_POINTS, NUM_HAND_POINTS
from solver_backend.types.shapes import Bool, Float

FINGER_M, PALM_M = 0.008, 0.011
"""Radius of a finger and half a palm's thickness (ANSUR II: fingers are 15 to 20 mm wide, hands 27 mm thick)."""
_BONES = np.array(
    [[0, 1 + 4 * finger] for finger in range(5)]
    + [[1 + 4 * finger + k, 2 + 4 * finger + k] for finger in range(5) for k in range(3)]
)
"""Both points of each bone of a hand: metacarpals first, then three of each finger."""
_RADII = np.array([PALM_M] * 5 + [FINGER_M] * 15)
_CHUNK = 64
"""Frames that are looked at together."""


def hidden_by_hands(
    centres: Float[np.ndarray, "cameras 3"], points: Float[np.ndarray, "frames 2 21 3"]
) -> Bool[np.ndarray, "cameras frames 2 21"]:
    """Return (C, F, 2, 21) whether a bone of either hand lies between a camera and a point.

    A point is hidden where the line of sight, from outside of the bones that it is on, passes one nearer than its
    radius: the least distance of two segments.

    Args:
        centres: (C, 3) metres.
        points: (F, 2, 21, 3) metres, left first.
    """
    frames = len(points)
    hidden = np.zeros((len(centres), frames, 2, NUM_HAND_POINTS), bool)
    for start in range(0, frames, _CHUNK):
        part = points[start : start + _CHUNK]
        flat = part.reshape(len(part), -1, 3)
        ends = part[:, :, _BONES].reshape(len(part), -1, 2, 3)
        for camera, centre in enumerate(centres):
            near = _segment_distances(flat, centre, ends) < np.tile(_RADII, 2)
            hidden[camera, start : start + _CHUNK] = (near & ~_OWN).any(-1).reshape(len(part), 2, NUM_HAND_POINTS)
    return hidden


def _own_bones() -> np.ndarray:
    """Return (42, 40) which bones a point is on: those that hold it; wrist and knuckles are on the palm."""
    own = (np.arange(NUM_HAND_POINTS)[:, None, None] == _BONES).any(-1)
    knuckles = [HAND_POINTS.index(name) for name in HAND_POINTS if name.endswith("_mcp")]
    own[[0, *knuckles], :5] = True
    both = np.zeros((2 * NUM_HAND_POINTS, 2 * len(_BONES)), bool)
    for hand in range(2):
        rows, columns = (slice(hand * count, (hand + 1) * count) for count in (NUM_HAND_POINTS, len(_BONES)))
        both[rows, columns] = own
    return both


_OWN = _own_bones()


def _segment_distances(points: np.ndarray, centre: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Return (f, P, B) metres between the segments from (f, P, 3) points to a camera and those of (f, B, 2, 3) bones.

    The nearest point of the line of sight to the bone's line, brought onto the bone, then back onto the line of sight.
    """
    sight = centre - points
    bone = ends[:, :, 1] - ends[:, :, 0]
    between = points[:, :, None] - ends[:, None, :, 0]
    a = (sight * sight).sum(-1)[:, :, None]
    c = (bone * bone).sum(-1)[:, None, :]
    b = np.einsum("fpi,fbi->fpb", sight, bone)
    d = np.einsum("fpi,fpbi->fpb", sight, between)
    e = np.einsum("fbi,fpbi->fpb", bone, between)
    along = np.clip((b * e - c * d) / np.maximum(a * c - b * b, 1e-12), 0.0, 1.0)
    on_bone = np.clip((b * along + e) / np.maximum(c, 1e-12), 0.0, 1.0)
    along = np.clip((b * on_bone - d) / np.maximum(a, 1e-12), 0.0, 1.0)
    gap = between + along[..., None] * sight[:, :, None] - on_bone[..., None] * bone[:, None]
    return np.linalg.norm(gap, axis=-1)
