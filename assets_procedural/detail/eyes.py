"""Build the eye: lids on an eyeball, their opening, and an iris and a pupil that look straight ahead.

The fitted surface has a slit at the eye that ends inside the head. It is replaced by rings for the lids, the edge of
the lids, the eyeball, the iris and the pupil. Depths follow a sphere and the surrounding skin, interpolated across the
eye.
"""

from __future__ import annotations

import numpy as np

from assets_procedural.arrays import EYEBALL, IRIS, NONE, PUPIL, Array
from assets_procedural.detail.patches import HalfBody, Oval, Patch, fan, replace, rings_to_faces, surface_around

EYE_CENTRE = np.array([0.0312, 1.5882, 0.1238])  # Left eyeball's centre in the fitted mesh, metres, floor at y = 0.
EYEBALL_M, IRIS_M, PUPIL_M = 0.0129, 0.0056, 0.0020  # Radii. An adult's iris is 11.7 mm wide (Rüfer et al. 2005).
_CORNEA_M = 0.0006
_LID_M, _SOFT_M = 0.0012, 0.0006
_CORNERS = np.array([[0.0432, 1.5890], [0.0199, 1.5873]])  # Outer and inner corners of the lids.
_UPPER_M, _LOWER_M = 0.0047, 0.0050
_EDGE_M = 0.0005  # Width of the edge of the lids.
_AROUND = 28  # Vertices in each ring.
_HOLE = Oval(np.array([0.0316, 1.5888]), np.array([0.0186, 0.0126]), least_z=0.07)  # Hole in the skin, in metres.
_LID_RINGS = (0.76, 0.48, 0.22)  # Rings of the lids, as fractions of the way from the lids' edge to the hole's rim.
_BALL_RINGS = (0.5,)
_CLIPPED = 0.86  # Largest radius of the iris, as a fraction of the distance to the lids' edge.
_SEEN_M, _BRIDGED_M = 0.010, 0.0022


def put_in_eye(half: HalfBody) -> HalfBody:
    """Return the half body with an eye. Raise ``BodyInvalid`` if the mesh has no slit for it."""
    return replace(half, _HOLE.holds, _eye(half))


def _eye(half: HalfBody) -> Patch:
    angle = 2.0 * np.pi * np.arange(_AROUND) / _AROUND
    edge, centre = _lid_edge(angle), EYE_CENTRE[:2]
    inwards = (centre - edge) / np.linalg.norm(centre - edge, axis=1, keepdims=True)
    near = _HOLE.holds(half.vertices, _SEEN_M)
    skin = surface_around(half, near, _between_lids(half.vertices))
    rim = _HOLE.centre + 0.97 * _HOLE.radii * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    lids = [edge + share * (rim - edge) for share in _LID_RINGS] + [edge]
    seen = edge + _EDGE_M * inwards
    iris, around = _iris_ring(seen, angle)
    ball = [seen] + [iris + share * (seen - iris) for share in _BALL_RINGS] + [iris]
    ball += [centre + 0.64 * (iris - centre), centre + PUPIL_M * around]
    points = [np.column_stack([ring, _lid_depth(ring, skin(ring))]) for ring in lids]
    points += [np.column_stack([ring, _ball_depth(ring)]) for ring in ball]
    vertices = np.concatenate([*points, np.array([[*centre, _ball_depth(centre[None])[0]]])])
    rings = list(np.arange(len(points) * _AROUND).reshape(-1, _AROUND))
    faces = np.concatenate([rings_to_faces(rings, closed=True), fan(rings[-1], len(vertices) - 1)])
    return Patch(vertices, faces, _shown(vertices, faces, len(lids)), rings[0], True)


def _iris_ring(seen: Array, angle: Array) -> tuple[Array, Array]:
    """Return the visible border (N, 2) of the iris, and the directions (N, 2) from the eye's centre to it.

    The lids limit the radius of the border. Each direction is the mean of an equally spaced angle and the angle of a
    point on the lids' edge, which avoids skewed faces.
    """
    out = seen - EYE_CENTRE[:2]
    to_edge = np.unwrap(np.arctan2(out[:, 1], out[:, 0]))
    ways = 0.5 * (angle + to_edge)
    reach = np.interp(ways, to_edge, np.linalg.norm(out, axis=1), period=2.0 * np.pi)
    around = np.stack([np.cos(ways), np.sin(ways)], axis=1)
    return EYE_CENTRE[:2] + np.minimum(IRIS_M, _CLIPPED * reach)[:, None] * around, around


def _shown(vertices: Array, faces: Array, lids: int) -> Array:
    away = np.linalg.norm(vertices[faces].mean(axis=1)[:, :2] - EYE_CENTRE[:2], axis=1)
    on_ball = np.arange(len(faces)) >= 2 * _AROUND * lids
    return np.select([~on_ball, away < PUPIL_M, away < IRIS_M], [NONE, PUPIL, IRIS], EYEBALL)


def _lid_edge(angle: Array) -> Array:
    share = 0.5 * (1.0 - np.cos(angle))[:, None]
    sine = np.sin(angle)
    height = np.where(sine > 0, _UPPER_M, -_LOWER_M) * np.abs(sine) ** np.where(sine > 0, 1.15, 1.3)
    return _CORNERS[0] + share * (_CORNERS[1] - _CORNERS[0]) + height[:, None] * [0.0, 1.0]


def _between_lids(vertices: Array) -> Array:
    middle, half_width = _CORNERS.mean(axis=0), 0.5 * abs(_CORNERS[0, 0] - _CORNERS[1, 0])
    reach = np.array([half_width, 0.5 * (_UPPER_M + _LOWER_M)]) + _BRIDGED_M
    return np.linalg.norm((vertices[:, :2] - middle) / reach, axis=1) < 1.0


def _sphere_depth(xy: Array, radius: float) -> Array:
    squared = radius**2 - np.sum((xy - EYE_CENTRE[:2]) ** 2, axis=1)
    return EYE_CENTRE[2] + np.sqrt(np.maximum(squared, (0.25 * radius) ** 2))


def _ball_depth(xy: Array) -> Array:
    squared = np.sum((xy - EYE_CENTRE[:2]) ** 2, axis=1) / (1.1 * IRIS_M) ** 2
    return _sphere_depth(xy, EYEBALL_M) + _CORNEA_M * np.maximum(1.0 - squared, 0.0)


def _lid_depth(xy: Array, skin: Array) -> Array:
    """Return the depth of the lids: a smooth maximum of the skin's depth and the lid sphere's depth."""
    lid = _sphere_depth(xy, EYEBALL_M + _LID_M)
    return np.maximum(skin, lid) + _SOFT_M * np.log1p(np.exp(-np.abs(skin - lid) / _SOFT_M))
