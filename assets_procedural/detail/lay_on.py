"""Add eyes, lips, wrists, toes and nails to the half body, so that both sides are exact mirror images."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.interpolate import RBFInterpolator
from scipy.sparse.linalg import spsolve

from assets_procedural.arrays import LIPS, NONE, Array, averaging, neighbour_graph
from assets_procedural.detail.eyes import put_in_eye
from assets_procedural.detail.nails import put_on_nails
from assets_procedural.detail.patches import HalfBody, Oval, Patch, replace, rings_to_faces, surface_around
from assets_procedural.layout import JOINT
from assets_procedural.mesh.meshing import SymmetricMesh, check_closed, mirror_half, on_grid

SEAM_Y, CORNER_M = 1.5217, 0.0220  # Height of the lip seam and half the mouth's width in the fitted mesh, metres.
_ALONG = 10  # Segments of the seam from the midline to the corner.
_UPPER_M, _LOWER_M = 0.0066, 0.0076  # Height of the red part of the upper and of the lower lip.
_RED = (0.17, 0.46, 0.74, 1.0)  # Rings on the red of the lips, as fractions of its height.
_BEYOND_M = (0.0011, 0.0019, 0.0027, 0.0035)  # How far each ring extends beyond the end of the seam.
_GROOVE_M, _GROOVE_WIDTH_M, _BORDER_M = 0.0019, 0.0011, 0.0006  # Groove between the lips, and their border.
_HOLE = Oval(np.array([0.0, SEAM_Y]), np.array([0.0305, 0.0128]), least_z=0.10)  # Hole for the mouth, in metres.
_SEEN_M, _BRIDGED_M = 0.012, 0.0021


def close_lips(half: HalfBody) -> HalfBody:
    """Return the half body with closed lips. Raise ``BodyInvalid`` if the mesh has no slit for them."""
    return replace(half, _HOLE.holds, _lips(half))


def _lips(half: HalfBody) -> Patch:
    vertices = half.vertices
    near = _HOLE.holds(vertices, _SEEN_M)
    slit = (np.abs(vertices[:, 1] - SEAM_Y) < _BRIDGED_M) & (vertices[:, 0] < CORNER_M + 0.003)
    skin = surface_around(half, near, slit)
    share = np.arange(_ALONG + 1) / _ALONG
    x = CORNER_M * share
    seam = np.column_stack([x, SEAM_Y - 0.0006 * (x / CORNER_M) ** 2 + 0.0004 * np.exp(-((x / 0.004) ** 2))])
    red = [_around(seam, k * _upper(x), k * _lower(x), beyond) for k, beyond in zip(_RED, _BEYOND_M, strict=True)]
    rim = _rim(len(red[0]))
    outer = [rim, 0.5 * rim + 0.5 * red[-1]]
    rings = [*outer, *red[::-1]]
    flat = np.concatenate([*rings, seam])
    depth = skin(flat) - _groove(flat, seam)
    depth[len(outer) * len(rim) :][: len(rim)] += _BORDER_M * (1.0 - np.minimum(red[-1][:, 0] / CORNER_M, 1.0) ** 2)
    points = np.column_stack([flat, depth])
    points[np.abs(points[:, 0]) < 1e-9, 0] = 0.0
    index = list(np.arange(len(rings) * len(rim)).reshape(-1, len(rim)))
    seam_index = len(rings) * len(rim) + np.arange(_ALONG + 1)
    innermost = np.concatenate([seam_index, seam_index[-1:], seam_index[::-1]])
    faces = rings_to_faces([*index, innermost], closed=False)
    feature = np.repeat([NONE] * len(outer) + [LIPS] * len(red), 2 * (len(rim) - 1))
    whole = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    return Patch(points, faces[whole][:, ::-1], feature[whole], index[0][::-1], False)


def _around(seam: Array, above: Array, below: Array, beyond: float) -> Array:
    """Return half of a ring around the lips: from the midline above the seam to the corner, and back below the seam."""
    rounding = beyond * (seam[:, 0] / CORNER_M) ** 4
    up = seam + np.column_stack([0.5 * rounding, np.maximum(above, 0.5 * rounding)])
    down = seam + np.column_stack([0.5 * rounding, -np.maximum(below, 0.5 * rounding)])
    corner = seam[-1:] + [[beyond, 0.0]]
    return np.concatenate([up, corner, down[::-1]])


def _upper(x: Array) -> Array:
    t = x / CORNER_M
    return _UPPER_M * ((1.0 - t**2.2) * (1.0 - 0.14 * np.exp(-((t / 0.13) ** 2))) + 0.16 * t)


def _lower(x: Array) -> Array:
    t = x / CORNER_M
    return _LOWER_M * ((1.0 - t**2.4) + 0.13 * t)


def _rim(count: int) -> Array:
    angle = 0.5 * np.pi - np.pi * np.arange(count) / (count - 1)
    ring = _HOLE.centre + 0.96 * _HOLE.radii * np.column_stack([np.cos(angle), np.sin(angle)])
    ring[[0, -1], 0] = 0.0
    return ring


def _groove(points: Array, seam: Array) -> Array:
    height = np.interp(points[:, 0], seam[:, 0], seam[:, 1])
    beyond = np.maximum(points[:, 0] - seam[-1, 0], 0.0)
    away = np.hypot(points[:, 1] - height, 2.0 * beyond)
    depth = _GROOVE_M * (1.0 - 0.55 * np.minimum(points[:, 0] / CORNER_M, 1.0) ** 2)
    return depth * np.exp(-((away / _GROOVE_WIDTH_M) ** 2))


_FROM_M, _TO_M = 0.022, 0.040  # Distances in front of the foot joint at which deepening begins and is complete.
_SMOOTHINGS, _SHRINK, _SWELL = 9, 0.55, -0.58  # Taubin 1995, "Curve and surface smoothing without shrinkage".
_GAIN, _MOST_M = 2.2, 0.004
_KEPT = (-1.0, -0.001, 0.0025), (1.0, 0.036, 0.041)  # keypoints lie on both outer toes, so the change fades out there
_SOLE_M = 0.006  # Skin below this does not move vertically, so that the soles stay on the floor.


def part_toes(vertices: Array, faces: Array, joints: Array) -> Array:
    """Deepen the gaps between the toes in the vertices of the half body (x >= 0, floor at y = 0).

    This is the unsharp mask ``v + g (v - S v)``, where S is repeated averaging over neighbours and g is the weight.
    """
    foot = joints[JOINT["left_foot"]]
    ahead = (vertices[:, 2] - foot[2] + 0.30 * np.abs(vertices[:, 0] - foot[0] + 0.02) - _FROM_M) / (_TO_M - _FROM_M)
    t = np.clip(ahead, 0.0, 1.0) * ((vertices[:, 1] < 0.06) & (vertices[:, 2] > 0.1))
    share = t * t * (3.0 - 2.0 * t)
    mean = averaging(sp.csr_matrix(neighbour_graph(faces, len(vertices)) + sp.eye(len(vertices))))
    smooth = vertices
    for _ in range(_SMOOTHINGS):
        for step in (_SHRINK, _SWELL):
            smooth = smooth + step * (mean @ smooth - smooth)
    change = _GAIN * (vertices - smooth)
    change *= share[:, None] * np.minimum(1.0, _MOST_M / np.maximum(np.linalg.norm(change, axis=1), 1e-9))[:, None]
    change[:, 1] *= np.clip(vertices[:, 1] / _SOLE_M, 0.0, 1.0)
    for sign, low, high in _KEPT:
        aside = sign * (vertices[:, 0] - foot[0])
        change *= 1.0 - np.clip((aside - low) / (high - low), 0.0, 1.0)[:, None]
    change[:, 2] = np.minimum(change[:, 2], 0.0)  # the length of the foot does not change
    return vertices + change


ULNA_HEAD = np.array([0.0060, 0.0150, -0.0262])  # Relative to the left wrist joint, in metres.
_OUTWARDS = np.array([0.0, 0.5, -0.866])
_REDONE_M, _AROUND_M = 0.012, 0.030  # Radius of the new skin, and radius of the skin around it.
_DOME_M, _DOME_WIDTH_M = 0.0009, 0.008


def round_ulna(vertices: Array, joints: Array) -> Array:
    """Round the head of the ulna in the vertices of the half body (x >= 0)."""
    offset = vertices - joints[JOINT["left_wrist"]] - ULNA_HEAD
    aside = np.cross(_OUTWARDS, [1.0, 0.0, 0.0])
    plane = offset @ np.stack([[1.0, 0.0, 0.0], aside], axis=1)
    height, away = offset @ _OUTWARDS, np.linalg.norm(plane, axis=1)
    here = np.abs(height) < 0.012
    fixed, free = here & (away >= _REDONE_M) & (away < _AROUND_M), here & (away < _REDONE_M)
    skin = RBFInterpolator(plane[fixed], height[fixed], kernel="thin_plate_spline")
    wanted = skin(plane[free]) + _DOME_M * np.exp(-((away[free] / _DOME_WIDTH_M) ** 2))
    out = vertices.copy()
    out[free] += (wanted - height[free])[:, None] * _OUTWARDS
    return out


@dataclass(frozen=True)
class DetailedBody:
    """A closed and symmetric body for close-ups, and the feature (T,) of each face, such as an iris or a nail."""

    mesh: SymmetricMesh
    feature: Array


def lay_on_details(mesh: SymmetricMesh, joints: Array) -> DetailedBody:
    """Add eyes, closed lips, round wrists, separate toes and nails to the fitted mesh.

    Raises:
        BodyInvalid: a detail is not where it is expected, or the result is not closed.
    """
    faces = mesh.faces[: len(mesh.faces) // 2]
    half = HalfBody(mesh.vertices[: faces.max() + 1], faces, np.full(len(faces), NONE))
    half = close_lips(put_in_eye(half))
    vertices = part_toes(round_ulna(half.vertices, joints), half.faces, joints)
    half = put_on_nails(HalfBody(vertices, half.faces, half.feature), joints)
    whole = mirror_half(on_grid(half.vertices), half.faces)
    check_closed(whole.faces, len(whole.vertices))
    return DetailedBody(whole, np.concatenate([half.feature, half.feature]))


_FACE = np.array([0.0, 0.050, 0.105]), np.array([0.068, 0.088, 0.085])
_EAR = np.array([0.0835, 0.055, 0.000]), np.array([0.028, 0.050, 0.040])
"""Centre (from the head joint) and radii of the ellipsoids to replace, in metres. Chosen by eye."""
_AROUND = 1.45  # Radii within which the surrounding skin defines the surface. Chosen by hand.
_MIDDLE = np.array([0.0, 0.060, 0.020])  # Centre of the rays that describe the head, in metres from the head joint.


def blank_face(vertices: Array, faces: Array, head: Array) -> tuple[Array, Array]:
    """Return the indices (N,) of the face's vertices, and the offsets (N, 3) in metres that remove the face.

    Each vertex first moves to the mean of its neighbours (Tutte 1963, "How to draw a graph"). It then moves along its
    ray from the centre of the head to a thin-plate surface through the surrounding skin.
    """
    folded = (vertices - head) * np.where(vertices[:, :1] < 0, [-1.0, 1.0, 1.0], 1.0)
    away = np.min([np.linalg.norm((folded - c) / radii, axis=1) for c, radii in (_FACE, _EAR)], axis=0)
    free, around, centre = away < 1.0, (away >= 1.0) & (away < _AROUND), head + _MIDDLE
    chosen, count = np.flatnonzero(free), len(vertices)
    plate = sp.csr_matrix(averaging(neighbour_graph(faces, count)) - sp.eye(count))
    own = sp.csr_matrix(plate[chosen])
    held = -sp.csr_matrix(own[:, ~free]) @ vertices[~free]
    even = spsolve(sp.csc_matrix(own[:, chosen]), held)
    radius, way = _rays(vertices[around] - centre)
    surface = RBFInterpolator(way, radius, kernel="thin_plate_spline", smoothing=1e-6)
    way = _rays(even - centre)[1]
    return chosen, centre + surface(way)[:, None] * way - vertices[chosen]


def _rays(points: Array) -> tuple[Array, Array]:
    length = np.linalg.norm(points, axis=1)
    return length, points / length[:, None]
