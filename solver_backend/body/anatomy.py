"""Define landmarks on any body by rules that use its joints and rays cast at its skin."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from weakref import WeakKeyDictionary

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.landmarks import Landmarks
from solver_backend.exchange.body_layout import SMPL
from solver_backend.exchange.errors import BodyInvalid
from solver_backend.geometry.small_matrices import dot

_KNOWN: WeakKeyDictionary[Body, dict[tuple[bytes, bytes, bool], SurfacePoint]] = WeakKeyDictionary()
"""Cached results of ray casts, by body, then by origin, direction and ``outermost``."""
SAME_M = 1e-9  # If a ray leaves several triangles within this distance, they share the edge or corner that it hits.


@dataclass(frozen=True)
class SurfacePoint:
    """A point on the mesh, given by barycentric coordinates in a triangle."""

    vertices: np.ndarray  # (3,) vertex indices.
    barycentric: np.ndarray  # (3,) coordinates that sum to 1.
    normal: np.ndarray  # (3,) outward unit normal.


def cast_ray(body: Body, origin: np.ndarray, direction: np.ndarray, *, outermost: bool = False) -> SurfacePoint:
    """Find the surface point where a ray first (or last, ``outermost``) leaves the rest mesh.

    The ray starts at ``origin`` (3,) inside the mesh, in metres in the rest pose. A miss raises ``BodyInvalid``.

    Reference: Möller and Trumbore 1997, "Fast, minimum storage ray-triangle intersection".
    """
    known = _KNOWN.setdefault(body, {})
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
        hint = "The body must be a closed T-posed mesh in SMPL's frame (Y up, facing +Z, metres)."
        what = f"A ray from {np.round(origin, 3)} along {np.round(direction, 3)} misses the mesh."
        raise BodyInvalid(what, where=body.id, hint=hint)
    normals = np.cross(edge1, edge2)
    leaving = hit & (normals @ direction > 0)
    reach = np.where(leaving if leaving.any() else hit, t, np.nan)
    # A ray in the median plane hits an edge. Choose the first triangle there, regardless of rounding.
    there = np.abs(reach - (np.nanmax(reach) if outermost else np.nanmin(reach))) <= SAME_M
    face = int(np.argmax(there))
    barycentric = np.array([1 - u[face] - v[face], u[face], v[face]]).clip(0)
    normal = normals[face] / np.linalg.norm(normals[face])
    return SurfacePoint(body.faces[face], barycentric / barycentric.sum(), normal)


@dataclass(frozen=True)
class AtJoints:
    """Landmark rule: a weighted mean of joints plus an offset in the rest pose, in metres at a stature of 1.70 m."""

    joints: dict[str, float]
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    finger: str = ""  # Joint that replaces it on bodies with finger joints.


@dataclass(frozen=True)
class OnSurface:
    """Landmark rule: the point where a ray first leaves the skin (last for the head, because mouths are hollow).

    The ray starts at a joint, or at the fraction ``along`` of the way to the joint ``towards``, shifted by ``start``.
    The point is then moved ``depth`` metres inwards (outwards if negative). Lengths are for a stature of 1.70 m.
    """

    joint: str
    direction: tuple[float, float, float]
    start: tuple[float, float, float] = (0.0, 0.0, 0.0)
    depth: float = 0.0
    towards: str = ""
    along: float = 0.0


@dataclass(frozen=True)
class Between:
    """Landmark rule: a weighted mean of other landmarks."""

    landmarks: dict[str, float] = field(default_factory=dict)


Rule = AtJoints | OnSurface | Between


class LandmarkBuilder:
    """Build landmarks on one body from rules."""

    def __init__(self, body: Body, rules: Mapping[str, tuple[str, Rule]], *, correctives: bool = False) -> None:
        """Prepare a builder for a closed T-posed body in SMPL's frame.

        Args:
            rules: for each landmark name, its side ('left', 'right' or '') and the rule for the left side.
            correctives: also compute pose correctives. Only landmarks on the skin need them.
        """
        self._body, self._rules, self._scale = body, rules, body.stature_m / 1.70
        self._correctives = correctives
        self._joints = dict(zip(SMPL.joints, body.layout.standing_for(SMPL), strict=True))
        self._points: list[tuple[np.ndarray, ...]] = []
        """Rest position, shape directions, skinning weights and pose directions of each skinned point."""

    def build(self, names: tuple[str, ...]) -> Landmarks:
        """Build the named landmarks. Raise ``BodyInvalid`` if a ray misses the mesh."""
        mixes = [self._landmark(name) for name in names]
        rest, shapedirs, weights, posedirs = (np.stack(parts) for parts in zip(*self._points, strict=True))
        if self._correctives:
            return Landmarks.of_points(names, rest, shapedirs, weights, posedirs=posedirs)
        mix = np.zeros((len(names), len(self._points)))
        for row, shares in enumerate(mixes):
            for point, share in shares.items():
                mix[row, point] += share
        return Landmarks.of_points(names, rest, shapedirs, weights, mix)

    def _landmark(self, name: str) -> dict[int, float]:
        side, rule = self._rules.get(name) or ("", AtJoints({name: 1.0}))  # otherwise a joint that the body itself has
        if isinstance(rule, Between):
            shares: dict[int, float] = {}
            for other, share in rule.landmarks.items():
                for point, part in self._landmark(other).items():
                    shares[point] = shares.get(point, 0.0) + share * part
            return shares
        if isinstance(rule, AtJoints):
            return self._at_joints(rule, side)
        return {self._on_surface(rule, side): 1.0}

    def _at_joints(self, rule: AtJoints, side: str) -> dict[int, float]:
        shares, places, offset = {}, rule.joints, self._vector(rule.offset, side)
        if rule.finger and f"{side}_{rule.finger}" in self._body.layout.solved:
            places, offset = {rule.finger: 1.0}, np.zeros(3)
        for joint, share in places.items():
            j = self._joint(joint, side)
            rest = self._body.joints_template[j] + offset
            one_hot = np.eye(len(self._body.parents))[j]
            still = np.zeros(self._body.posedirs.shape[1:])
            shares[self._add(rest, self._body.joints_shapedirs[j], one_hot, still)] = share
        return shares

    def _on_surface(self, rule: OnSurface, side: str) -> int:
        origin = self._body.joints_template[self._joint(rule.joint, side)]
        if rule.towards:
            origin = origin + rule.along * (self._body.joints_template[self._joint(rule.towards, side)] - origin)
        origin, direction = origin + self._vector(rule.start, side), self._vector(rule.direction, side)
        hit, body = cast_ray(self._body, origin, direction, outermost=rule.joint == "head"), self._body
        share, at = hit.barycentric, hit.vertices
        rest = share @ body.v_template[at] - rule.depth * hit.normal
        shapedirs, posedirs = (np.tensordot(share, d[at], axes=1) for d in (body.shapedirs, body.posedirs))
        return self._add(rest, shapedirs, share @ body.weights[at], posedirs)

    def _add(self, *point: np.ndarray) -> int:
        self._points.append(point)
        return len(self._points) - 1

    def _joint(self, joint: str, side: str) -> int:
        name = joint if not side or joint in self._joints else f"{side}_{joint}"
        return self._joints[name] if name in self._joints else self._body.layout.numbers(name)[0]

    def _vector(self, value: tuple[float, float, float], side: str) -> np.ndarray:
        return np.array(value, dtype=np.float64) * self._scale * ([-1, 1, 1] if side == "right" else [1, 1, 1])
