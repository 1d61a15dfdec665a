"""The body made of ellipsoids, a few of each part, and of points that give its box: sight lines without the mesh."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.landmark_set import Landmarks
from solver_backend.body.landmarks import pose_landmarks
from solver_backend.synthesis.simulation.cast import Person

_SLAB_M = 0.08
"""Parts are cut across their longest axis into slabs of about this length, an ellipsoid each."""
_MOST_SLABS = 8
_ALONG, _ACROSS = 0.7, 1.03
"""Half axes of an ellipsoid: along by its slab's length, across by the slab's elliptic cross-section; tuned by how
often sight lines end as at the mesh (``tests/synthesis/studio/test_sight.py``)."""
_LEAST_M = 0.008
_DIRECTIONS = 26
_SPREAD = 120
"""Points spread over the whole skin beside those at its parts' ends."""


@dataclass(frozen=True)
class PosedProxy:
    """A proxy in F frames, world metres."""

    middle: np.ndarray
    """(F, S, 3)."""
    shape: np.ndarray
    """(F, S, 3, 3) float32, 1/m^2."""
    points: np.ndarray
    """(F, P, 3)."""
    turn: np.ndarray
    """(F, J, 3, 3) global rotations of the bones."""


@dataclass(frozen=True)
class _Slab:
    """A piece of a part."""

    vertices: np.ndarray
    """(n,) of the skin."""
    weight: np.ndarray
    """(n,) their areas, together 1."""
    axis: np.ndarray
    """(3,) it is cut across."""
    bone: int


@dataclass(frozen=True)
class _Plan:
    """What does not depend on the shape."""

    slabs: tuple[_Slab, ...]
    landmarks: Landmarks
    share: np.ndarray


@dataclass(frozen=True)
class BodyProxy:
    """S ellipsoids and P points of the skin of one shape."""

    landmarks: Landmarks
    """The S middles of the ellipsoids, then the P points; they move as the skin does, without correctives."""
    bone: np.ndarray
    """(S,) bone that turns each ellipsoid."""
    shape: np.ndarray
    """(S, 3, 3) matrices B of ``x^T B x = 1`` at rest, 1/m^2."""
    share: np.ndarray
    """(P,) share of the skin that each point stands for."""

    def posed(self, person: Person) -> PosedProxy:
        """Return the proxy in a person's F frames, world metres."""
        found = pose_landmarks(person.body, self.landmarks, person.betas, person.orient, person.local, person.transl)
        count = len(self.bone)
        turn = found.skeleton.G[:, self.bone].astype(np.float32)
        shape = turn @ self.shape.astype(np.float32) @ np.swapaxes(turn, -1, -2)
        return PosedProxy(found.points[:, :count], shape, found.points[:, count:], found.skeleton.G)


def body_proxy(body: Body, betas: np.ndarray) -> BodyProxy:
    """Return the proxy of a body of (10,) betas, fitted to its skin at rest."""
    plan = _plan(body)
    skin = body.v_template + body.shapedirs @ betas
    shapes = np.stack([_ellipsoid(skin[slab.vertices], slab.weight, slab.axis) for slab in plan.slabs])
    return BodyProxy(plan.landmarks, np.array([slab.bone for slab in plan.slabs]), shapes, plan.share)


@lru_cache(maxsize=8)
def _plan(body: Body) -> _Plan:
    skin = body.v_template
    area = _vertex_areas(skin, body.faces)
    part = body.weights.argmax(axis=1)
    slabs: list[_Slab] = []
    ends = []
    for bone in np.unique(part).tolist():
        chosen = np.flatnonzero(part == bone)
        ends.append(_extremes(skin, chosen))
        slabs += _slabs(skin, area, chosen, bone)
    points = _spread(skin, np.unique(np.concatenate(ends)), _SPREAD)
    share = np.bincount(_nearest(skin, skin[points]), minlength=len(points)) / len(skin)
    mix = np.zeros((len(slabs) + len(points), len(skin)))
    for row, slab in enumerate(slabs):
        mix[row, slab.vertices] = slab.weight
    mix[len(slabs) + np.arange(len(points)), points] = 1.0
    names = tuple(f"proxy {i}" for i in range(len(mix)))
    landmarks = Landmarks.of_points(names, skin, body.shapedirs, body.weights, mix)
    return _Plan(tuple(slabs), landmarks, share)


def _slabs(skin: np.ndarray, area: np.ndarray, chosen: np.ndarray, bone: int) -> list[_Slab]:
    """Return a part cut into slabs across its longest axis."""
    centred = skin[chosen] - np.average(skin[chosen], axis=0, weights=area[chosen])
    axis = np.linalg.eigh((centred * area[chosen, None]).T @ centred)[1][:, -1]
    along = centred @ axis
    low, high = float(along.min()), float(along.max())
    count = int(np.clip(round((high - low) / _SLAB_M), 1, _MOST_SLABS))
    which = np.clip(((along - low) / (high - low) * count).astype(int), 0, count - 1)
    pieces = [chosen[which == i] for i in range(count)]
    return [_Slab(piece, area[piece] / area[piece].sum(), axis, bone) for piece in pieces if len(piece) > 8]


def _ellipsoid(points: np.ndarray, weight: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Return the (3, 3) matrix of a slab's ellipsoid; a ring of half axes a and b has variances a^2/2 and b^2/2."""
    centred = points - weight @ points
    along = centred @ axis
    flat = centred - np.outer(along, axis)
    spread, turn = np.linalg.eigh((flat * weight[:, None]).T @ flat)
    across = np.maximum(_ACROSS * np.sqrt(2 * np.maximum(spread[1:], 0)), _LEAST_M)
    # Of the three directions the first is the axis itself, along which nothing is left.
    frame = np.column_stack([axis, turn[:, 1:]])
    return (frame / np.array([max(_ALONG * np.ptp(along), _LEAST_M), *across]) ** 2) @ frame.T


def _vertex_areas(skin: np.ndarray, faces: np.ndarray) -> np.ndarray:
    across = np.cross(skin[faces[:, 1]] - skin[faces[:, 0]], skin[faces[:, 2]] - skin[faces[:, 0]])
    each = np.repeat(np.linalg.norm(across, axis=1) / 6, 3)
    return np.bincount(faces.ravel(), each, minlength=len(skin)) + 1e-12


def _extremes(skin: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Return the vertices of a part that lie farthest in directions spread over the sphere (Fibonacci lattice)."""
    i = np.arange(_DIRECTIONS) + 0.5
    z, turn = 1 - 2 * i / _DIRECTIONS, np.pi * (1 + 5**0.5) * i
    ways = np.stack([np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z])
    return chosen[np.unique((skin[chosen] @ ways).argmax(axis=0))]


def _spread(skin: np.ndarray, points: np.ndarray, more: int) -> np.ndarray:
    """Return the points with as many more, each the farthest from all before it."""
    off = (_squares(skin, skin[points]) + (skin**2).sum(axis=1)[:, None]).min(axis=1)
    found = points.tolist()
    for _ in range(more):
        found.append(int(off.argmax()))
        off = np.minimum(off, ((skin - skin[found[-1]]) ** 2).sum(axis=1))
    return np.array(found)


def _nearest(skin: np.ndarray, points: np.ndarray) -> np.ndarray:
    return _squares(skin, points).argmin(axis=1)


def _squares(skin: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return (V, P) squared distances, less the squared length of each of the skin's."""
    return (points**2).sum(axis=1) - 2 * skin @ points.T
