"""Points on the body's surface, found by casting rays at the rest mesh."""

from __future__ import annotations

from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np

from solver_backend.body.body import Body
from solver_backend.exchange.errors import BodyInvalid
from solver_backend.geometry.short_axis import dot

_KNOWN: WeakKeyDictionary[Body, dict[tuple[bytes, bytes, bool], SurfacePoint]] = WeakKeyDictionary()
"""Where the rays of the anatomical rules leave each body, which solves of markers ask for again and again."""
SAME_M = 1e-9
"""Triangles that a ray leaves so near to each other are met at their common edge or corner."""


@dataclass(frozen=True)
class SurfacePoint:
    """A point of the mesh: barycentric coordinates on one triangle."""

    vertices: np.ndarray
    """(3,) vertex indices."""
    barycentric: np.ndarray
    """(3,) sums to 1."""
    normal: np.ndarray
    """(3,) outward unit normal."""


def cast_ray(body: Body, origin: np.ndarray, direction: np.ndarray, *, outermost: bool = False) -> SurfacePoint:
    """Return where a ray that starts inside the rest mesh first leaves it.

    Args:
        body: the body model.
        origin: (3,) start, rest frame, metres.
        direction: (3,) any length.
        outermost: take where it leaves the mesh for good; a head may have a hollow mouth and nostrils.

    Raises:
        BodyInvalid: the ray misses the mesh.

    Reference: Möller and Trumbore 1997, "Fast, minimum storage ray-triangle intersection".
    """
    if (known := _KNOWN.get(body)) is None:
        known = _KNOWN[body] = {}
    ray = np.asarray(origin, np.float64).tobytes(), np.asarray(direction, np.float64).tobytes(), outermost
    if ray not in known:
        known[ray] = _cast(body, origin, direction, outermost)
    return known[ray]


def _cast(body: Body, origin: np.ndarray, direction: np.ndarray, outermost: bool) -> SurfacePoint:
    direction = np.asarray(direction, dtype=np.float64) / np.linalg.norm(direction)
    corners = body.v_template[body.faces]
    edge1, edge2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    p = np.cross(direction, edge2)
    determinant = dot(edge1, p)
    with np.errstate(divide="ignore", invalid="ignore"):
        offset = origin - corners[:, 0]
        u = dot(offset, p) / determinant
        q = np.cross(offset, edge1)
        v = (q @ direction) / determinant
        t = dot(edge2, q) / determinant
        hit = (np.abs(determinant) > 1e-14) & (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1 + 1e-9) & (t > 0)
    if not hit.any():
        raise BodyInvalid(
            f"A ray from {np.round(origin, 3)} along {np.round(direction, 3)} misses the mesh.",
            where=body.id,
            hint="The body must be a closed T-posed mesh in SMPL's frame (Y up, facing +Z, metres).",
        )
    normals = np.cross(edge1, edge2)
    leaving = hit & (normals @ direction > 0)
    reach = np.where(leaving if leaving.any() else hit, t, np.nan)
    # A ray at the body's middle meets an edge: of the triangles there the first, whatever rounding makes of them.
    there = np.abs(reach - (np.nanmax(reach) if outermost else np.nanmin(reach))) <= SAME_M
    face = int(np.argmax(there))
    barycentric = np.array([1 - u[face] - v[face], u[face], v[face]]).clip(0)
    normal = normals[face] / np.linalg.norm(normals[face])
    return SurfacePoint(body.faces[face], barycentric / barycentric.sum(), normal)
