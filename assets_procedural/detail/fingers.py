"""Curl the fitted, spread fingers into a loose rest pose. The little finger curls most.

Each finger rotates at three knuckles, starting at the tip. Each angle is multiplied by a weight that increases smoothly
along the finger. Between two fingers, the skin follows their mean, weighted by distance.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from assets_procedural.arrays import FLIP, Array, smooth_step, table
from assets_procedural.layout import JOINT
from assets_procedural.skeleton.skinning import distance_to_segment

_UP = np.array([0.0, 1.0, 0.0])
_WEB_M = 0.003  # Distance beyond the nearest finger at which another finger has little influence on the skin.
_PALM_M = 0.016, 0.030  # Distances from the thumb's axis. Skin that is closer rotates with the thumb.


@dataclass(frozen=True)
class Digit:
    """A finger of the left hand, from its first knuckle to its tip."""

    knots: tuple[tuple[float, float, float], ...]  # Three knuckles and the tip, in metres from the hand joint.
    flexion_deg: tuple[float, float, float]  # Angle added at each knuckle, towards the palm.
    closing_deg: float  # Rotation at the first knuckle towards the thumb.
    soft_m: tuple[float, float, float] = (0.011, 0.007, 0.006)  # Half the length of each bend.


DIGITS = {name: Digit(**row) for name, row in table("digits").items()}  # Digits of the fitted hand, thumb first.
STRAIGHTENED = 1.14471  # Length of the hand with straight fingers, relative to resting fingers.


def finger_knots(joints: Array) -> Array:
    """Return the knots (40, 3) of both hands in metres: three knuckles and the tip of each finger."""
    left = joints[JOINT["left_hand"]] + np.concatenate([digit.knots for digit in DIGITS.values()])
    return np.concatenate([left, left * FLIP])


def relaxed_knots(knots: Array) -> Array:
    """Curl the fingers of knots (40, 3, C). Each of the C columns is a position or a derivative w.r.t. the shape."""
    turned = []
    for half, flip in zip(np.split(knots, 2), (1.0, -1.0), strict=True):
        sign = np.array([flip, 1.0, 1.0])[:, None]
        for own, digit in zip(np.split(half * sign, len(DIGITS)), DIGITS.values(), strict=True):
            turned.append(_bent(np.array(digit.knots), own, own, digit) * sign)
    return np.concatenate(turned)


def relax_fingers(points: Array, knots: Array, straight: Array, joints: Array) -> Array:
    """Curl the fingers of body points (V, 3, C). The columns are positions and derivatives w.r.t. the shape.

    A point p moves to ``k + R (p - k)`` at each knuckle k, where R is the knuckle's rotation, reduced by the point's
    weight. This is linear in p and k, so derivatives follow the same rule. ``knots`` (40, 3, C) come from
    ``finger_knots``. Weights are computed on the fitted body, with points ``straight`` (V, 3) and ``joints`` (24, 3).
    """
    out, hand, wrist = points.copy(), joints[JOINT["left_hand"]], joints[JOINT["left_wrist"]]
    for half, flip in zip(np.split(knots, 2), (1.0, -1.0), strict=True):
        sign = np.array([flip, 1.0, 1.0])
        chosen = straight[:, 0] * flip > wrist[0]
        place, turned = straight[chosen] * sign - hand, sign[:, None]
        out[chosen] = _curled(place, points[chosen] * turned, (half * turned).reshape(len(DIGITS), 4, 3, -1)) * turned
    return out


def _curled(place: Array, points: Array, knots: Array) -> Array:
    """Curl points (N, 3, C) of the left hand. ``place`` (N, 3) are their positions on the fitted body, for weights."""
    near = {
        name: np.min([distance_to_segment(place, *bone) for bone in pairwise(np.array(digit.knots))], axis=0)
        for name, digit in DIGITS.items()
    }
    away = np.stack([near[name] for name in DIGITS if name != "thumb"])
    share = np.exp(-(away - away.min(axis=0)) / _WEB_M)
    share /= share.sum(axis=0)
    of_thumb = (1.0 - smooth_step(near["thumb"], *_PALM_M)) * (near["thumb"] < away.min(axis=0))
    shares = np.concatenate([of_thumb[None], np.where(of_thumb > 0, 0.0, share)])
    bent = [_bent(place, points, knots[k], digit) for k, digit in enumerate(DIGITS.values())]
    return points + sum(s[:, None, None] * (to - points) for s, to in zip(shares, bent, strict=True))


def _bent(place: Array, points: Array, knots: Array, digit: Digit) -> Array:
    chain = np.array(digit.knots)
    along = np.diff(chain, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    for k in (2, 1, 0):
        before = along[max(k - 1, 0)] + along[k]
        share = smooth_step((place - chain[k]) @ before / np.linalg.norm(before), -digit.soft_m[k], digit.soft_m[k])
        hinge = np.cross(along[k], _UP)
        vector = -np.deg2rad(digit.flexion_deg[k]) * hinge / np.linalg.norm(hinge)
        if k == 0:
            vector = vector + np.deg2rad(-digit.closing_deg) * _UP
        turn = Rotation.from_rotvec(share[:, None] * vector).as_matrix()
        points = knots[k] + np.einsum("nab,nbc->nac", turn, points - knots[k])
    return points
