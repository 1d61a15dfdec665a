"""Replace a part of the half mesh by rings: cut a hole, and join its rim to the outermost ring."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.interpolate import RBFInterpolator
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from assets_procedural.arrays import NONE, Array, half_edges, normal_sums
from solver_backend.exchange.errors import BodyInvalid

_BESIDE_M, _BEHIND_M = 0.0045, 0.007
Mask = Callable[[Array], Array]
Depth = Callable[[Array], Array]


@dataclass(frozen=True)
class HalfBody:
    """Half mesh (x >= 0, floor at y = 0), and the feature (T,) of each face, such as an iris or a nail."""

    vertices: Array
    faces: Array
    feature: Array


@dataclass(frozen=True)
class Patch:
    """Part of a mesh that fills a hole. Its outermost ring is joined to the rim of the hole."""

    vertices: Array  # (P, 3) metres.
    faces: Array  # (Q, 3) indices into ``vertices``, wound so that the front faces outwards.
    feature: Array
    ring: Array  # (R,) indices of the outermost vertices, counter-clockwise when seen from the front.
    closed: bool  # True if the ring is closed. If False, it begins and ends on x = 0.


@dataclass(frozen=True)
class Oval:
    """An upright ellipse in the front view. Only vertices with z above ``least_z`` count as inside."""

    centre: Array
    radii: Array
    least_z: float

    def holds(self, vertices: Array, wider_m: float = 0.0) -> Array:
        """Return a mask (V,) of the vertices (V, 3) inside the oval, with radii enlarged by ``wider_m``."""
        apart = np.linalg.norm((vertices[:, :2] - self.centre) / (self.radii + wider_m), axis=1)
        return (apart < 1.0) & (vertices[:, 2] > self.least_z)


def replace(half: HalfBody, hole: Mask, patch: Patch) -> HalfBody:
    """Replace the vertices that ``hole`` marks by a patch. Raise ``BodyInvalid`` if the hole has several rims."""
    keep = _outside(half.faces, ~hole(half.vertices)[half.faces].any(axis=1), len(half.vertices))
    used = np.unique(half.faces[keep])
    renamed = np.full(len(half.vertices), -1)
    renamed[used] = np.arange(len(used))
    rim = renamed[_rim(half.faces[keep], half.faces[~keep], patch.closed)]
    vertices = np.concatenate([half.vertices[used], patch.vertices])
    own = len(used)
    band = zip_rings(vertices, rim, own + patch.ring, patch.closed)
    faces = np.concatenate([renamed[half.faces[keep]], own + patch.faces, band])
    feature = np.concatenate([half.feature[keep], patch.feature, np.full(len(band), NONE)])
    return HalfBody(vertices, faces, feature)


def surface_around(half: HalfBody, near: Array, left_out: Array) -> Depth:
    """Return a function z(x, y) for the front skin, fitted to vertices that are ``near`` but not ``left_out``."""
    total = normal_sums(half.vertices, half.faces)
    facing = near & (total[:, 2] > 0.35 * np.linalg.norm(total, axis=1))
    points = half.vertices[facing & ~left_out]
    points = points[_uncovered(points, half.vertices[near])]
    across = points[points[:, 0] < 0.02] * [-1.0, 1.0, 1.0]  # mirrored, for symmetry at the midline
    points = np.concatenate([points, across[across[:, 0] < 0]])
    plate = RBFInterpolator(points[:, :2], points[:, 2], kernel="thin_plate_spline", smoothing=1e-9)
    return lambda xy: plate(xy)


def _uncovered(points: Array, others: Array) -> Array:
    """Return a mask of the points with no other point more than 7 mm in front. This excludes pockets under the skin."""
    beside = KDTree(others[:, :2]).query_ball_point(points[:, :2], _BESIDE_M)
    return np.array([z > others[found, 2].max() - _BEHIND_M for z, found in zip(points[:, 2], beside, strict=True)])


def rings_to_faces(rings: list[Array], closed: bool) -> Array:
    """Return the outward-facing faces (Q, 3) between rings of equal length, listed from the outside inwards."""
    faces = []
    for outer, inner in pairwise(rings):
        after = np.roll(np.arange(len(outer)), -1) if closed else np.arange(1, len(outer))
        here = np.arange(len(after))
        a, b, c, d = outer[here], outer[after], inner[after], inner[here]
        even = (here % 2 == 0)[:, None]
        faces.append(np.where(even, np.stack([a, b, c], 1), np.stack([a, b, d], 1)))
        faces.append(np.where(even, np.stack([a, c, d], 1), np.stack([b, c, d], 1)))
    return np.concatenate(faces)


def fan(ring: Array, middle: int) -> Array:
    """Return the faces (R, 3) between a closed ring and a vertex at its centre."""
    return np.stack([ring, np.roll(ring, -1), np.full(len(ring), middle)], axis=1)


def zip_rings(vertices: Array, rim: Array, ring: Array, closed: bool) -> Array:
    """Return the faces (Q, 3) between the rim of a hole and a ring inside it."""
    if closed:
        start = int(np.linalg.norm(vertices[rim] - vertices[ring[0]], axis=1).argmin())
        rim = np.concatenate([np.roll(rim, -start), rim[start : start + 1]])
        ring = np.concatenate([ring, ring[:1]])
    faces, i, j = [], 0, 0
    while i < len(rim) - 1 or j < len(ring) - 1:
        ahead = _gap(vertices, rim, ring, i + 1, j)
        inside = _gap(vertices, rim, ring, i, j + 1)
        if ahead <= inside:
            faces.append((rim[i], rim[i + 1], ring[j]))
            i += 1
        else:
            faces.append((rim[i], ring[j + 1], ring[j]))
            j += 1
    return np.array(faces)


def _gap(vertices: Array, rim: Array, ring: Array, i: int, j: int) -> float:
    """Return the distance from rim vertex i to ring vertex j, rounded to a micrometre, or infinity past either end."""
    if i >= len(rim) or j >= len(ring):
        return np.inf
    return round(float(np.linalg.norm(vertices[rim[i]] - vertices[ring[j]])), 6)


def _outside(faces: Array, keep: Array, count: int) -> Array:
    """Return a mask (T,) of the kept faces in the largest piece. This drops pockets under the skin."""
    if not keep.any():
        raise BodyInvalid("The rim of a hole is empty: the hole takes all.", hint="Fit the hole to the mesh again.")
    edges = np.array(sorted(_directed(faces[keep])))
    _, label = connected_components(coo_matrix((np.ones(len(edges)), edges.T), shape=(count, count)), directed=False)
    return keep & (label[faces[:, 0]] == np.bincount(label[faces[keep][:, 0]]).argmax())


def _rim(kept: Array, removed: Array, closed: bool) -> Array:
    inner, outer = _directed(removed), _directed(kept)
    after = {a: b for a, b in inner if (b, a) in outer}
    starts = sorted(set(after) - set(after.values()))
    if len(starts) != (0 if closed else 1) or not after:
        raise BodyInvalid(f"The rim of a hole has {len(starts)} loose ends.", hint="Fit the hole to the mesh again.")
    chain = [starts[0] if starts else min(after)]
    while chain[-1] in after and (len(chain) == 1 or chain[-1] != chain[0]):
        chain.append(after[chain[-1]])
    chain = chain[:-1] if closed else chain
    if len(chain) != len(after) + (0 if closed else 1):
        raise BodyInvalid("The rim of a hole is more than one chain.", hint="Fit the hole to the mesh again.")
    return np.array(chain)


def _directed(faces: Array) -> set[tuple[int, int]]:
    return {(int(a), int(b)) for a, b in half_edges(faces)}
