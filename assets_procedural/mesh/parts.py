"""Body parts and materials of the mesh's faces."""

from __future__ import annotations

import numpy as np

from assets_procedural.layout import ANKLE, CUFF, NECKLINE
from assets_procedural.mesh import features

SKIN, SUIT, LIPS, EYEBALL, IRIS, PUPIL, NAIL = range(7)
MATERIAL_NAMES = ("skin", "suit", "lips", "eyeball", "iris", "pupil", "nail")
"""Names of the materials, in the order of their numbers."""
PART_FACING = np.array(
    [
        (0.0, 0.0, 1.0),  # head
        (0.0, 0.0, 1.0),  # torso
        (0.0, 0.0, 1.0),  # left leg
        (0.0, 0.0, 1.0),  # right leg
        (0.0, 1.0, 0.0),  # left foot
        (0.0, 1.0, 0.0),  # right foot
        (0.0, 1.0, 0.0),  # left arm
        (0.0, 1.0, 0.0),  # right arm
        (0.0, 1.0, 0.0),  # left hand
        (0.0, 1.0, 0.0),  # right hand
    ]
)
"""(10, 3) direction that the first shell of each part faces."""
_ARM_X, _CROTCH_Y = 0.19, 0.83


def face_parts(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return the (F,) part of each face of the fitted mesh, floor at y = 0."""
    centre = vertices[faces].mean(axis=1)
    right = (centre[:, 0] < 0).astype(np.int64)
    folded = centre * np.where(right[:, None] == 1, np.array([-1.0, 1.0, 1.0]), 1.0)
    arm = (folded[:, 0] > _ARM_X) & (folded[:, 1] > 1.15)
    conditions = [
        (NECKLINE.side(folded) > 0) & NECKLINE.near(folded) | (folded[:, 1] > NECKLINE.high[1]),
        CUFF.side(folded) > 0,
        arm,
        ANKLE.side(folded) < 0,
        folded[:, 1] < _CROTCH_Y,
    ]
    return np.select(conditions, [np.zeros_like(right), 8 + right, 6 + right, 4 + right, 2 + right], 1)


def face_materials(part: np.ndarray, feature: np.ndarray) -> np.ndarray:
    """Return the (F,) material of each face: head, hands and feet are skin, the rest wears a suit; eyes and lips.

    Args:
        part: (F,) from ``face_parts``.
        feature: (F,) numbers of ``features``.
    """
    plain = np.where(np.isin(part, (0, 4, 5, 8, 9)), SKIN, SUIT)
    of_feature = {
        features.LIPS: LIPS, features.EYEBALL: EYEBALL, features.IRIS: IRIS, features.PUPIL: PUPIL, features.NAIL: NAIL,
    }  # fmt: skip
    conditions = [feature == number for number in of_feature]
    return np.select(conditions, list(of_feature.values()), plain).astype(np.uint8)
