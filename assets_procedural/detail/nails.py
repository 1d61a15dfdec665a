"""Add the nails of ten fingers and of the big toes, as plates in the fitted skin."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.interpolate import RBFInterpolator

from assets_procedural.arrays import NAIL, NONE, Array, normal_sums
from assets_procedural.detail.fingers import DIGITS
from assets_procedural.detail.patches import HalfBody, Patch, fan, replace, rings_to_faces
from assets_procedural.layout import JOINT

_AROUND = 10  # Vertices in each ring.
_RINGS = (1.0, 0.86, 0.74)  # Skin, bottom of the fold and border of the plate, as fractions of the oval's radii.
_HOLE = 1.25  # Factor for the radii of the skin to replace. A larger hole avoids narrow faces around the nail.
_FOLD_M, _PLATE_M = -0.0004, 0.0003  # Fold below the skin, and plate above it. Chosen by hand.
_DEEP_M, _BESIDE_M = 0.009, 0.011  # Limits of the surrounding skin: depth below the nail's centre, and distance.
_FACING = 0.45  # Smallest cosine between the normals of skin and nail at which the skin defines the surface.


@dataclass(frozen=True)
class NailPlace:
    """Position, axes and size of a nail on the left side."""

    centre: Array  # (3,) metres, within 2 mm of the skin.
    tip: Array  # (3,) unit vector towards the tip.
    up: Array  # (3,) unit vector out of the skin, perpendicular to ``tip``.
    radii: Array  # (2,) radii across and along the nail in metres, including the fold.

    @property
    def axes(self) -> Array:
        """Return the axes (3, 3) of the nail, one per row: across, along and up."""
        return np.stack([np.cross(self.tip, self.up), self.tip, self.up])


_FINGERS: dict[str, tuple[float, float, tuple[float, float], float]] = {
    "thumb": (0.58, 36.0, (0.0062, 0.0076), 0.0040),
    "index": (0.52, 0.0, (0.0054, 0.0064), 0.0033),
    "middle": (0.56, 0.0, (0.0056, 0.0066), 0.0045),
    "ring": (0.54, 0.0, (0.0054, 0.0064), 0.0033),
    "little": (0.52, 0.0, (0.0046, 0.0055), 0.0040),
}
"""For each finger: position from knuckle to tip (0 to 1), roll in degrees, and radii and height in metres."""
_BIG_TOE = ((-0.011, -0.0024, 0.0585), (0.0, -0.30, 1.0), (0.0080, 0.0080))  # Offset from foot, direction, radii.


def put_on_nails(half: HalfBody, joints: Array) -> HalfBody:
    """Add nails to the half body. Raise ``BodyInvalid`` if a nail is not on the skin."""
    for place in _places(joints):
        local = (half.vertices - place.centre) @ place.axes.T
        total = normal_sums(half.vertices, half.faces)
        facing = total @ place.up > _FACING * np.linalg.norm(total, axis=1)
        reachable = (np.abs(local[:, 2]) < _DEEP_M) & facing
        near = (np.linalg.norm(local[:, :2], axis=1) < _BESIDE_M) & reachable
        skin = RBFInterpolator(local[near, :2], local[near, 2], kernel="thin_plate_spline", smoothing=1e-9)
        hole = (np.linalg.norm(local[:, :2] / place.radii, axis=1) < _HOLE) & reachable
        half = replace(half, lambda _, hole=hole: hole, _nail(place, skin))
    return half


def _places(joints: Array) -> list[NailPlace]:
    found, hand = [], joints[JOINT["left_hand"]]
    for name, (share, roll, radii, height) in _FINGERS.items():
        knuckle, end = (hand + np.array(knot) for knot in DIGITS[name].knots[-2:])
        along = (end - knuckle) / np.linalg.norm(end - knuckle)
        up, angle = _upright(along), np.deg2rad(roll)
        up = np.cos(angle) * up + np.sin(angle) * np.cross(along, up)
        found.append(NailPlace(knuckle + share * (end - knuckle) + height * up, along, up, np.array(radii)))
    offset, way, radii = (np.array(numbers) for numbers in _BIG_TOE)
    along = way / np.linalg.norm(way)
    return [*found, NailPlace(joints[JOINT["left_foot"]] + offset, along, _upright(along), radii)]


def _upright(along: Array) -> Array:
    """Return the unit vector that is perpendicular to ``along`` and closest to up."""
    up = np.array([0.0, 1.0, 0.0]) - along[1] * along
    return up / np.linalg.norm(up)


def _nail(place: NailPlace, skin: RBFInterpolator) -> Patch:
    angle = 2.0 * np.pi * np.arange(_AROUND) / _AROUND
    cosine, sine = np.cos(angle), np.sin(angle)
    outline = np.stack([np.sign(cosine) * np.abs(cosine) ** 0.75, sine], axis=1) * place.radii
    flat = np.concatenate([*(share * outline for share in _RINGS), np.zeros((1, 2))])
    height = np.repeat([0.0, _FOLD_M, _PLATE_M, _PLATE_M], [_AROUND] * len(_RINGS) + [1])
    vertices = place.centre + np.column_stack([flat, skin(flat) + height]) @ place.axes
    rings = list(np.arange(len(_RINGS) * _AROUND).reshape(-1, _AROUND))
    plate = fan(rings[-1], len(vertices) - 1)
    bands = [rings_to_faces([outer, inner], closed=True) for outer, inner in pairwise(rings)]
    feature = np.repeat([NONE, NONE, NAIL], [len(bands[0]), len(bands[1]), len(plate)])
    return Patch(vertices, np.concatenate([*bands, plate]), feature, rings[0], True)
