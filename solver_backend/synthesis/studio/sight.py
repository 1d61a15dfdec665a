"""Find the points that cameras see, with a few matrix products.

An ellipsoid of the body or a piece of furniture hides a point if it blocks the line of sight. The line ``t w`` from the
camera, ``0 <= t <= 1``, intersects an ellipsoid ``(x - c)^T B (x - c) = 1`` if ``(w^T B c)^2 > (w^T B w) (c^T B c -
1)``. It enters the ellipsoid before its own end if ``w^T B c < w^T B w`` or if the end is inside.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.landmarks import Landmarks
from solver_backend.body.mesh import face_normals
from solver_backend.synthesis.simulation.cast import Person
from solver_backend.synthesis.simulation.keypoint_detector import own_faces, stabbed_faces
from solver_backend.types import SMPL_JOINTS, Cameras

CLEARANCE_M = 0.035  # Distance (m) from a sight line's end to its point, which is on or slightly below the skin.
_PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))  # Row and column of the six entries of a symmetric matrix.


def sight_lines(centres: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return the (F, C, K, 3) vectors from camera centres to points (F, K, 3). Each ends just before its point."""
    lines = (points[:, None] - centres[:, None]).astype(np.float32)
    length = np.sqrt(np.einsum("fcki,fcki->fck", lines, lines))
    return lines * np.maximum(1 - CLEARANCE_M / np.maximum(length, 1e-6), 0)[..., None]


def hidden_by_ellipsoids(
    centres: np.ndarray, lines: np.ndarray, middle: np.ndarray, shape: np.ndarray, counted: np.ndarray
) -> np.ndarray:
    """Return an (F, C, K) mask of the sight lines that an ellipsoid blocks.

    Args:
        centres: (C, 3) camera centres in metres.
        lines: (F, C, K, 3) lines from ``sight_lines``.
        middle: (F, S, 3) centres of the ellipsoids in metres.
        shape: (F, S, 3, 3) matrices of the ellipsoids, 1/m^2.
        counted: (S, K) mask of the points that each ellipsoid can hide.
    """
    frames, views, count = lines.shape[:3]
    towards = (middle[:, None] - centres[:, None]).astype(np.float32)
    shape = shape.astype(np.float32)
    bent = np.swapaxes(np.swapaxes(towards, 1, 2) @ shape, 1, 2)
    outside = (bent * towards).sum(axis=-1) - 1
    squares = np.stack([lines[..., i] * lines[..., j] for i, j in _PAIRS], axis=-2)
    six = np.stack([shape[..., i, j] * (1 if i == j else 2) for i, j in _PAIRS], axis=-1)
    ww = six[:, None] @ squares
    wb = bent @ np.swapaxes(lines, -1, -2)
    k = outside[..., None]
    ends_inside = ww - 2 * wb + k < 0
    entered = (wb > 0) & (wb < ww) & (wb * wb > ww * k)
    found = (entered | ends_inside) & (k > 0) & counted
    return found.any(axis=-2).reshape(frames, views, count)


_CELLS = 28  # Cells per side of the octahedral map (Engelhardt and Dachsbacher 2008), each about 5 degrees wide.
_FAR_M = 3.0  # Camera distance in metres used for a table. Further away, sight lines are the same. Chosen by hand.
_GROUPS = (("head",), ("left_wrist", "left_hand"), ("right_wrist", "right_hand"))


@dataclass(frozen=True)
class RigidSight:
    """Lookup tables of the directions from which the head or a hand hides points on its own surface."""

    point: np.ndarray  # (Q,) index of each point.
    bone: np.ndarray  # (Q,) bone that each table moves with.
    table: np.ndarray  # (Q, cells) mask of the directions that hide a point.
    parts: np.ndarray  # (Q, J) mask of the parts that each table accounts for.

    def hidden(self, centres: np.ndarray, points: np.ndarray, turn: np.ndarray) -> np.ndarray:
        """Return an (F, C, Q) mask of the points that are hidden by the head or hand to which they belong."""
        way = (centres[:, None] - points[:, None, self.point]).astype(np.float32)
        local = np.einsum("fqji,fcqj->fcqi", turn[:, self.bone].astype(np.float32), way, optimize=True)
        return self.table[np.arange(len(self.point)), _cell(local)]


def rigid_sight(body: Body, landmarks: Landmarks, counted: np.ndarray) -> RigidSight:
    """Compute the lookup tables for a body's mean shape.

    Landmarks attached to the head or a single hand get a table. ``counted`` (J, K) is a mask of the points that each
    part can hide.
    """
    face_part = body.weights[body.faces].sum(axis=1).argmax(axis=1)
    at, bone, tables, parts = [], [], [], []
    ways = _directions()
    for group in _GROUPS:
        bones = [body.recorded_joints[SMPL_JOINTS.index(name)] for name in group]
        carried = np.flatnonzero(landmarks.weights[:, bones].sum(axis=1) > 0.85)
        target = landmarks.anchors[carried].sum(axis=1)
        of_group = np.flatnonzero(np.isin(face_part, bones))
        if not len(carried) or not len(of_group):
            continue
        used, faces = np.unique(body.faces[of_group], return_inverse=True)
        skin, faces = body.v_template[used], faces.reshape(-1, 3)
        can = counted[face_part[of_group]][:, carried]
        table = np.zeros((len(carried), len(ways)), dtype=bool)
        for cell, way in enumerate(ways):
            frame = _looking(-way)
            middle = target.mean(axis=0) + _FAR_M * way
            face, point = stabbed_faces((skin - middle) @ frame.T, faces, (target - middle) @ frame.T)
            table[point[can[face, point]], cell] = True
        at.append(carried)
        bone.append(np.full(len(carried), bones[0]))
        tables.append(table)
        parts.append(np.tile(np.isin(np.arange(len(body.parents)), bones), (len(carried), 1)))
    return RigidSight(*(np.concatenate(found) for found in (at, bone, tables, parts)))


def _directions() -> np.ndarray:
    """Return (cells, 3) unit vectors through the centres of the octahedral map's cells."""
    ticks = (np.arange(_CELLS) + 0.5) / _CELLS * 2 - 1
    x, y = (grid.ravel() for grid in np.meshgrid(ticks, ticks, indexing="ij"))
    z = 1 - np.abs(x) - np.abs(y)
    ways = np.stack([*_folded(x, y, z), z], axis=1)
    return ways / np.linalg.norm(ways, axis=1, keepdims=True)


def _cell(ways: np.ndarray) -> np.ndarray:
    sides = _folded(*np.moveaxis(ways / np.abs(ways).sum(axis=-1, keepdims=True), -1, 0))
    i, j = (np.clip(((side + 1) * (0.5 * _CELLS)).astype(np.int32), 0, _CELLS - 1) for side in sides)
    return i * _CELLS + j


def _folded(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unfold the lower half of an octahedron in the plane, or fold it again. Return the new x and y."""
    below, out = z < 0, ((1 - np.abs(y)) * np.copysign(1, x), (1 - np.abs(x)) * np.copysign(1, y))
    return np.where(below, out[0], x), np.where(below, out[1], y)


def _looking(way: np.ndarray) -> np.ndarray:
    """Return the (3, 3) rotation to the frame of a camera that looks in a given direction."""
    side = np.cross(way, [0.0, 1.0, 0.0] if abs(way[1]) < 0.9 else [1.0, 0.0, 0.0])
    side /= np.linalg.norm(side)
    return np.stack([side, np.cross(way, side), way])


_SLAB_M = 0.08  # Length (m) of a slab of a part along its longest axis. Each slab becomes an ellipsoid.
_MOST_SLABS = 8
_ALONG, _ACROSS = 0.7, 1.03  # Half axes of an ellipsoid relative to its slab, tuned to match the mesh's occlusion.
_LEAST_M = 0.008
_DIRECTIONS = 26  # Number of directions for the search of a part's extreme points.
_SPREAD = 120  # Number of points spread over the whole skin, in addition to the extreme points of the parts.


@dataclass(frozen=True)
class PosedProxy:
    """A posed body proxy over F frames, in world coordinates in metres."""

    middle: np.ndarray  # (F, S, 3) centres of the ellipsoids.
    shape: np.ndarray  # (F, S, 3, 3) float32 matrices of the ellipsoids, 1/m^2.
    points: np.ndarray  # (F, P, 3) skin points.
    turn: np.ndarray  # (F, J, 3, 3) global rotations of the bones.


@dataclass(frozen=True)
class _Slab:
    vertices: np.ndarray  # (n,) skin vertices.
    weight: np.ndarray  # (n,) relative areas, which add up to 1.
    axis: np.ndarray  # (3,) direction perpendicular to the cuts.
    bone: int


@dataclass(frozen=True)
class BodyProxy:
    """A simplified body for visibility tests: S ellipsoids and P skin points."""

    landmarks: Landmarks  # Centres of the S ellipsoids, followed by the P points, without pose correctives.
    bone: np.ndarray  # (S,) bone that each ellipsoid rotates with.
    shape: np.ndarray  # (S, 3, 3) matrices B of ``x^T B x = 1`` at rest, 1/m^2.
    share: np.ndarray  # (P,) fraction of the skin that each point represents.

    def posed(self, person: Person) -> PosedProxy:
        """Pose the proxy like a person in F frames."""
        found, count = person.pose(self.landmarks), len(self.bone)
        turn = found.skeleton.G[:, self.bone].astype(np.float32)
        shape = turn @ self.shape.astype(np.float32) @ np.swapaxes(turn, -1, -2)
        return PosedProxy(found.points[:, :count], shape, found.points[:, count:], found.skeleton.G)


def body_proxy(body: Body, betas: np.ndarray) -> BodyProxy:
    """Fit the proxy of a body with betas (10,) to its skin at rest."""
    slabs, landmarks, share = _plan(body)
    skin = body.v_template + body.shapedirs @ betas
    shapes = np.stack([_ellipsoid(skin[slab.vertices], slab.weight, slab.axis) for slab in slabs])
    return BodyProxy(landmarks, np.array([slab.bone for slab in slabs]), shapes, share)


@lru_cache(maxsize=8)
def _plan(body: Body) -> tuple[list[_Slab], Landmarks, np.ndarray]:
    """Return the ellipsoid slabs of a body, the proxy's landmarks, and each skin point's share of the skin."""
    skin = body.v_template
    sizes = np.repeat(np.linalg.norm(face_normals(skin, body.faces), axis=1) / 6, 3)
    area = np.bincount(body.faces.ravel(), sizes, minlength=len(skin)) + 1e-12
    part = body.weights.argmax(axis=1)
    slabs: list[_Slab] = []
    ends = []
    for bone in np.unique(part).tolist():
        chosen = np.flatnonzero(part == bone)
        ends.append(_extremes(skin, chosen))
        slabs += _slabs(skin, area, chosen, bone)
    points = _spread(skin, np.unique(np.concatenate(ends)), _SPREAD)
    share = np.bincount(_squares(skin, skin[points]).argmin(axis=1), minlength=len(points)) / len(skin)
    mix = np.zeros((len(slabs) + len(points), len(skin)))
    for row, slab in enumerate(slabs):
        mix[row, slab.vertices] = slab.weight
    mix[len(slabs) + np.arange(len(points)), points] = 1.0
    names = tuple(f"proxy {i}" for i in range(len(mix)))
    return slabs, Landmarks.of_points(names, skin, body.shapedirs, body.weights, mix), share


def _slabs(skin: np.ndarray, area: np.ndarray, chosen: np.ndarray, bone: int) -> list[_Slab]:
    """Cut a body part into slabs along its longest axis."""
    centred = skin[chosen] - np.average(skin[chosen], axis=0, weights=area[chosen])
    axis = np.linalg.eigh((centred * area[chosen, None]).T @ centred)[1][:, -1]
    along = centred @ axis
    low, high = float(along.min()), float(along.max())
    count = int(np.clip(round((high - low) / _SLAB_M), 1, _MOST_SLABS))
    which = np.clip(((along - low) / (high - low) * count).astype(int), 0, count - 1)
    pieces = [chosen[which == i] for i in range(count)]
    return [_Slab(piece, area[piece] / area[piece].sum(), axis, bone) for piece in pieces if len(piece) > 8]


def _ellipsoid(points: np.ndarray, weight: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Return the (3, 3) matrix of an ellipsoid that approximates a ring of skin about ``axis`` (a slab of a limb)."""
    centred = points - weight @ points
    along = centred @ axis
    flat = centred - np.outer(along, axis)
    spread, turn = np.linalg.eigh((flat * weight[:, None]).T @ flat)
    across = np.maximum(_ACROSS * np.sqrt(2 * np.maximum(spread[1:], 0)), _LEAST_M)
    # The first of the three directions is the axis itself, along which no extent is left.
    frame = np.column_stack([axis, turn[:, 1:]])
    return (frame / np.array([max(_ALONG * np.ptp(along), _LEAST_M), *across]) ** 2) @ frame.T


def _extremes(skin: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Return the outermost vertices of a body part in directions spread over a sphere."""
    i = np.arange(_DIRECTIONS) + 0.5
    z, turn = 1 - 2 * i / _DIRECTIONS, np.pi * (1 + 5**0.5) * i
    ways = np.stack([np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z])
    return chosen[np.unique((skin[chosen] @ ways).argmax(axis=0))]


def _spread(skin: np.ndarray, points: np.ndarray, more: int) -> np.ndarray:
    """Add ``more`` skin points to the given points, one by one. Each is the furthest from all previous points."""
    off = (_squares(skin, skin[points]) + (skin**2).sum(axis=1)[:, None]).min(axis=1)
    found = points.tolist()
    for _ in range(more):
        found.append(int(off.argmax()))
        off = np.minimum(off, ((skin - skin[found[-1]]) ** 2).sum(axis=1))
    return np.array(found)


def _squares(skin: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return (V, P) squared distances between skin vertices and points, up to a constant per vertex."""
    return (points**2).sum(axis=1) - 2 * skin @ points.T


class BodySight:
    """Visibility of a body's K keypoints. Lookup tables are cached per ``landmarks`` object."""

    def __init__(self, body: Body, betas: np.ndarray, landmarks: Landmarks) -> None:
        self.proxy = body_proxy(body, betas)
        self._rigid, counted = _tables(body, landmarks)
        self._counted = counted[self.proxy.bone]

    def hidden(self, centres: np.ndarray, lines: np.ndarray, points: np.ndarray, posed: PosedProxy) -> np.ndarray:
        """Return an (F, C, K) mask of the keypoints that the body hides from each camera."""
        hidden = hidden_by_ellipsoids(centres, lines, posed.middle, posed.shape, self._counted)
        hidden[..., self._rigid.point] |= self._rigid.hidden(centres, points, posed.turn)
        return hidden


def cast_lines(
    proxy: BodyProxy, person: Person, cameras: Cameras, points: np.ndarray, size: int = 32
) -> Iterator[tuple[slice, PosedProxy, np.ndarray]]:
    """Yield chunks of ``size`` frames: the slice, the posed proxy, and the (F, C, K, 3) sight lines."""
    for start in range(0, len(points), size):
        chunk = slice(start, start + size)
        yield chunk, proxy.posed(person.part(chunk)), sight_lines(cameras.centres, points[chunk])


def own_parts(body: Body, names: tuple[str, ...]) -> np.ndarray:
    """Return a (K, T) mask of the faces that cannot hide a point, because they belong to the body parts around it."""
    own = own_faces(body, names)
    part = body.weights[body.faces].sum(axis=1).argmax(axis=-1)
    for k, name in enumerate(names):
        if name in SMPL_JOINTS and not own[k].any():
            joint = body.recorded_joints[SMPL_JOINTS.index(name)]
            meeting = [joint, body.parents[joint], *(j for j, p in enumerate(body.parents) if p == joint)]
            own[k] = np.isin(part, meeting)
    return own


@lru_cache(maxsize=8)
def _tables(body: Body, landmarks: Landmarks) -> tuple[RigidSight, np.ndarray]:
    """Return the lookup tables of head and hands.

    Also return a (J, K) mask of the keypoints that the ellipsoids of each part can hide.
    """
    part = body.weights[body.faces].sum(axis=1).argmax(axis=1)
    own = own_parts(body, landmarks.names)
    counted = np.stack([~own[:, part == bone].any(axis=1) for bone in range(len(body.parents))])
    rigid = rigid_sight(body, landmarks, counted)
    for point, parts in zip(rigid.point, rigid.parts, strict=True):
        counted[parts, point] = False
    return rigid, counted
