"""The flat hand, which AMASS and the SMPL family count finger rotations from, as rotations of our bones from rest."""

from __future__ import annotations

import numpy as np

from assets_procedural.arrays import Array
from assets_procedural.hand.correctives import left_skeleton
from assets_procedural.hand.joints import HandJoints
from solver_backend.body.hand_angles import ANGLES
from solver_backend.body.hand_on_body import COLUMNS

_THUMB_SPREAD_DEG = 25.0
"""A flat hand's thumb lies beside the palm, a little below it."""


def flat_rotations(hands: HandJoints) -> Array:
    """Return (30, 3, 3) rotations from rest to a flat hand, of each finger bone as a whole, in SMPL-H's order.

    Args:
        hands: rest joints and fingertips.
    """
    skeleton = left_skeleton(hands)
    angles = skeleton.rest_angles.copy()
    angles[[name.endswith("flexion") for name in ANGLES]] = 0.0
    angles[ANGLES.index("thumb_cmc_spread")] = np.radians(_THUMB_SPREAD_DEG)
    turned = (skeleton.pose(angles[None]).frames[0, :, 1:] @ np.swapaxes(skeleton.rest, -1, -2)).reshape(-1, 3, 3)
    left = np.zeros_like(turned)
    left[np.array(COLUMNS).ravel()] = turned
    flip = np.array([-1.0, 1.0, 1.0])
    return np.concatenate([left, left * flip[:, None] * flip])
