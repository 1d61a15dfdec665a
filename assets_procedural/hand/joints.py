"""Rest joints of the fingers: knuckles at the fitted hand's knots, the joints beyond them amid the finger."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from assets_procedural.arrays import Array
from assets_procedural.detail.fingers import DIGITS, relaxed_knots
from assets_procedural.hand.sections import section_centre
from assets_procedural.hand.tree import FIRST, LEFT, MIRROR, PER_FINGER
from solver_backend.exchange.body_layout import SMPL_FINGERS

_DIGIT = {"pinky": "little"}
"""Names of the generator's digits where they are not SMPL-H's fingers'."""
_ROUNDS = 3
"""How often the joints are moved to the middle of sections that halve the bend between them."""
_FREE_SKIN, _BESIDE_M = 0.65, 0.006
"""Share of a finger's first bone at which its skin is its own, beyond the web; metres that a knuckle moves at most."""
_FLIP = np.array([-1.0, 1.0, 1.0])


@dataclass(frozen=True)
class HandJoints:
    """The body's joints with fingers, and where the fingers end."""

    joints: Array
    """(52, 3) metres."""
    joint_dirs: Array
    """(52, 3, C) metres per unit of C shapes."""
    tips: Array
    """(10, 3) metres: the ends of the fingers inside the skin, in SMPL-H's order."""


@dataclass(frozen=True)
class Knots:
    """The knots of both hands' relaxed digits, the thumb first; see ``finger_knots``."""

    points: Array
    """(40, 3) metres."""
    directions: Array
    """(40, 3, 10) metres per unit of shape."""

    @classmethod
    def relaxed(cls, spread: Array, directions: Array) -> Knots:
        """Return the knots of the fitted body's, given while its fingers are spread.

        Args:
            spread: (40, 3) metres.
            directions: (40, 3, 10) metres per unit of shape.
        """
        return cls(relaxed_knots(spread[..., None])[..., 0], relaxed_knots(directions))


def place_hand_joints(
    joints: Array, joint_dirs: Array, knots: Knots, vertices: Array, dirs: Array, faces: Array
) -> HandJoints:
    """Return the joints of the body with fingers at rest.

    Args:
        joints: (24, 3) metres.
        joint_dirs: (24, 3, 10) metres per unit of shape.
        knots: of the relaxed digits.
        vertices: (V, 3) rest vertices, metres.
        dirs: (V, 3, 10) metres per unit of shape.
        faces: (T, 3).
    """
    left, left_dirs = _in_order(knots.points), _in_order(knots.directions)
    centres = np.zeros((len(left), len(vertices)))
    moved = np.isin(np.arange(len(left)) % 4, (1, 2))
    for _ in range(_ROUNDS):
        for k in np.flatnonzero(moved):
            along = _unit(left[k + 1] - left[k]) + _unit(left[k] - left[k - 1])
            centres[k] = section_centre(vertices, faces, left[k], along)
        left[moved] = centres[moved] @ vertices
    left_dirs[moved] = np.tensordot(centres[moved], dirs, axes=(1, 0))
    for k in np.flatnonzero(np.arange(len(left)) % 4 == 0):
        place, along = left[k] + _FREE_SKIN * (left[k + 1] - left[k]), _unit(left[k + 1] - left[k])
        centre = section_centre(vertices, faces, place, along)
        shift = centre @ vertices - place
        # Where the palm's skin is around the bone, its section holds nothing of the finger.
        if np.linalg.norm(shift) < _BESIDE_M:
            place_dirs = left_dirs[k] + _FREE_SKIN * (left_dirs[k + 1] - left_dirs[k])
            left[k], left_dirs[k] = left[k] + shift, left_dirs[k] + np.tensordot(centre, dirs, axes=1) - place_dirs
    is_joint = np.arange(len(left)) % 4 < PER_FINGER
    found, found_dirs = np.zeros((len(MIRROR), 3)), np.zeros((len(MIRROR), 3, dirs.shape[2]))
    found[:FIRST], found_dirs[:FIRST] = joints[:FIRST], joint_dirs[:FIRST]
    for side in (list(LEFT), [MIRROR[j] for j in LEFT]):
        flip = np.ones(3) if side[0] == FIRST else _FLIP
        found[side], found_dirs[side] = left[is_joint] * flip, left_dirs[is_joint] * flip[:, None]
    return HandJoints(found, found_dirs, np.concatenate([left[~is_joint], left[~is_joint] * _FLIP]))


def _in_order(values: Array) -> Array:
    """Return the left hand's knots in the order of SMPL-H's fingers."""
    names = list(DIGITS)
    order = [names.index(_DIGIT.get(finger, finger)) for finger in SMPL_FINGERS]
    digits = values[: len(values) // 2].reshape(len(names), 4, *values.shape[1:])
    return digits[order].reshape(-1, *values.shape[1:])


def _unit(vector: Array) -> Array:
    return vector / np.linalg.norm(vector)
