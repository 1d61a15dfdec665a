"""Add correctives to the shown body, so that shoulders, elbows and hips bend naturally.

The solver uses the correctives in the body file, which do not change. The skin in Blender has a smoother target. The
linearly blended skin and the rest skin are both smoothed over a few centimetres. Then the difference between the rest
skin and its smoothed copy is added again in rotated frames (delta mush, Mancewicz, Derksen, Rijpkema and Wilson 2014).
Stretched skin swells to replace lost volume. The back of a bent elbow protrudes, its inside ends where both sides
touch, and an arm at the side does not enter the ribs.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu
from scipy.spatial import KDTree

from assets_procedural.arrays import Array, neighbour_graph, smooth_step
from assets_procedural.layout import CHILDREN, JOINT, PARENTS
from assets_procedural.skeleton.correctives import (
    SECOND_BEND,
    dual_quaternion_blend,
    fit_by_joint,
    joint_masks,
    masked_to_rest,
    parted,
    without_slight,
)
from assets_procedural.skeleton.skinning import (
    cotangent_laplacian,
    linear_blend,
    pose_skeleton,
    vertex_areas,
    vertex_normals,
    volume,
)
from solver_backend.body.kinematics import subtree_matrix
from solver_backend.types import SMPL_JOINTS


class _Way(NamedTuple):
    """Parameters for the skin around a joint. Chosen by eye on ``tests.benchmarks.body_sheets``."""

    radius_m: float  # Radius of the smoothing.
    dual: float  # Fraction of dual-quaternion skinning in the target.
    gain: float  # Fraction of the lost volume that stretched skin restores, before the fit.
    growth: tuple[float, float] = (0.0, 1e-9)  # Growth of area at which swelling begins, and at which it is complete.


_WAYS = {
    "collar": _Way(0.040, 0.0, 0.0),
    "shoulder": _Way(0.040, 0.1, 0.5),
    "elbow": _Way(0.022, 0.0, 1.0),
    "hip": _Way(0.040, 0.7, 1.5, (0.6, 1.0)),
}
"""Parameters for the joints that get additional correctives."""
_SECOND = SECOND_BEND | {"left_hip": ((-0.74, 0.66, -0.12), 0.0, 2.3)}  # as when sitting cross-legged
_REACH = 0.02, 0.35  # Smoothed joint weights at which added correctives begin and are complete.
_LARGEST_SWELLING_M = 0.03
_HIP_SCALE, _CROTCH_M, _PIT_M = 1.3, (0.05, 0.10), (0.0, 0.02)
"""Factor at the hips, and ranges in metres over which additions fade: from the midline, and before the elbow."""
_FAINT_M = 5e-4  # Smallest row to add if the body file lacks it. A row takes 116 bytes.
_POINT_M, _POINT_WIDTH_M = 0.010, 0.020  # Height and radius of the tip of a bent elbow.
_PUSHES, _GAP_M = 4, 0.001  # Rounds that move an arm out of the ribs, and the gap that remains.
_APART_M, _DEEPEST_M = 0.05, 0.03  # Skin that is closer than this at rest, or deeper inside, is not pushed.


class DeltaMush:
    """Smooths a posed skin over a radius and restores the details of the rest skin."""

    def __init__(self, vertices: Array, faces: Array, radius_m: float) -> None:
        laplacian, area = cotangent_laplacian(vertices, faces)
        self._mass = sp.diags(area)
        # Two implicit steps of heat flow spread a point over the radius, whatever the size of the triangles.
        self._solve = splu((self._mass + 0.25 * radius_m**2 * laplacian).tocsc()).solve
        self._graph, self._faces = neighbour_graph(faces, len(vertices)), faces
        self._degree = np.asarray(self._graph.sum(axis=1)).ravel()[:, None, None]
        self._smooth = self.smooth(vertices)
        self._details, self._normals = vertices - self._smooth, vertex_normals(self._smooth, faces)
        self._size = np.trace(self._spread(self._smooth), axis1=1, axis2=2)[:, None, None]

    def smooth(self, values: Array) -> Array:
        """Return values (V, ...) smoothed over the radius."""
        for _ in range(2):
            values = self._solve(self._mass @ values)
        return values

    def __call__(self, posed: Array) -> Array:
        """Return the posed skin (V, 3), smoothed and with its details."""
        smooth = self.smooth(posed)
        normals = vertex_normals(smooth, self._faces)
        spread = self._spread(smooth) + self._size * normals[:, :, None] * self._normals[:, None]
        left, _, right = np.linalg.svd(spread)  # the rotation of the neighbourhood from rest (Kabsch 1976)
        left[:, :, 2] *= np.linalg.det(left @ right)[:, None]
        return smooth + np.einsum("vab,vb->va", left @ right, self._details)

    def _spread(self, points: Array) -> Array:
        """Return sums (V, 3, 3) of ``(q_j - q) (p_j - p)^T`` over neighbours j, where p is the smoothed rest skin."""
        rest, graph = self._smooth, self._graph
        pairs = (graph @ np.einsum("va,vb->vab", points, rest).reshape(-1, 9)).reshape(-1, 3, 3)
        pairs -= points[:, :, None] * (graph @ rest)[:, None] + (graph @ points)[:, :, None] * rest[:, None]
        return pairs + self._degree * points[:, :, None] * rest[:, None]


def shown_correctives(
    vertices: Array, faces: Array, weights: Array, joints: Array, mirror: Array, posedirs: Array
) -> Array:
    """Return correctives (V, 3, 207) to add to ``posedirs``, in metres per unit of the pose features."""
    masks, wide = joint_masks(weights), np.zeros((len(vertices), len(PARENTS) - 1))
    mushes = {radius: DeltaMush(vertices, faces, radius) for radius in sorted({way.radius_m for way in _WAYS.values()})}
    names = tuple(name for name in SMPL_JOINTS if _kind(name) in _WAYS)
    for name in names:
        smooth = mushes[_WAYS[_kind(name)].radius_m].smooth
        wide[:, JOINT[name] - 1] = smooth_step(smooth(masks[:, JOINT[name] - 1]), *_REACH)
    beyond = weights @ subtree_matrix(PARENTS).T > 0.5

    def wanted(joint: int, turn: Array) -> Array:
        local = np.tile(np.eye(3), (len(PARENTS), 1, 1))
        local[joint] = turn
        bones, mask, kind = pose_skeleton(joints, local), wide[:, joint - 1], _kind(SMPL_JOINTS[joint])
        way = _WAYS[kind]
        mush, dual = mushes[way.radius_m], dual_quaternion_blend(vertices, weights, *bones)
        target = (1.0 - way.dual) * mush(linear_blend(vertices, weights, *bones)) + way.dual * dual
        if kind == "elbow":
            bone = joints[CHILDREN[joint][0]] - joints[joint]
            target = parted(vertices, target, joints[joint], bone, turn, mask)
            target = target + _point(vertices, joints[joint], bone, turn)
        if kind == "shoulder":
            target = _pushed_out(vertices, target, faces, beyond[:, joint], mask)
        stretch = vertex_areas(target, faces) / vertex_areas(vertices, faces)
        share = mush.smooth(masks[:, joint - 1] * (stretch - 0.7).clip(0.0, 0.8)) * smooth_step(stretch, *way.growth)
        target = target + way.gain * _swelling(vertices, target, faces, share)
        return masked_to_rest(mask, target, vertices, weights, *bones)

    found = fit_by_joint(names, wide, mirror, wanted, second=_SECOND)
    ours = np.repeat([_kind(name) in _WAYS for name in SMPL_JOINTS[1:]], 9)
    share = np.repeat(_shares(vertices, joints), 9, axis=1)[:, None]
    added = without_slight(np.where(ours, share * (found - posedirs), 0.0))
    return np.where(_has_row(posedirs, 0.0) | _has_row(added, _FAINT_M), added, 0.0)


def _shares(vertices: Array, joints: Array) -> Array:
    """Return the weights (V, 23) of the additions, which fade out at the crotch and the elbow.

    The factor at the hips compensates for this. It was chosen on 24 poses of ``body_shape``, seeds 11 and 60.
    """
    shares = np.ones((len(vertices), len(PARENTS) - 1))
    for name, joint in JOINT.items():
        if name.endswith("hip"):
            shares[:, joint - 1] = _HIP_SCALE * smooth_step(np.abs(vertices[:, 0]), *_CROTCH_M)
        if name.endswith("elbow"):
            shares[:, joint - 1] = 1.0 - smooth_step(vertices[:, 2] - joints[joint, 2], *_PIT_M)
    return shares


def _has_row(directions: Array, least: float) -> Array:
    """Return a mask (V, 1, 207) of correctives that move a vertex by more than ``least``."""
    largest = np.abs(directions).reshape(len(directions), 3, -1, 9).max(axis=(1, 3))
    return np.repeat(largest > least, 9, axis=1)[:, None]


def _swelling(vertices: Array, posed: Array, faces: Array, share: Array) -> Array:
    """Return offsets (V, 3) in metres along the normals. They restore the rest volume."""
    lost = volume(vertices, faces) - volume(posed, faces)
    amount = lost / max(float(share @ vertex_areas(posed, faces)), 1e-9)
    limit = _LARGEST_SWELLING_M / max(float(share.max()), 1e-9)
    return (np.clip(amount, 0.0, limit) * share)[:, None] * vertex_normals(posed, faces)


def _pushed_out(vertices: Array, posed: Array, faces: Array, beyond: Array, mask: Array) -> Array:
    """Move both sides of a joint apart, each by half of their penetration."""
    apart, here = posed, mask > 0
    for _ in range(_PUSHES):
        normals, move = vertex_normals(apart, faces), np.zeros_like(posed)
        for side in (beyond, ~beyond):
            own, other = np.flatnonzero(side & here), np.flatnonzero(~side)
            distance, found = KDTree(apart[other]).query(apart[own])
            found = other[found]
            inside = -np.einsum("va,va->v", apart[own] - apart[found], normals[found])
            far = np.linalg.norm(vertices[own] - vertices[found], axis=1) > _APART_M
            hit = far & (distance < _DEEPEST_M) & (inside > -_GAP_M)
            move[own[hit]] = 0.5 * (inside[hit] + _GAP_M)[:, None] * normals[found[hit]]
        apart = apart + mask[:, None] * move
    return apart


def _kind(name: str) -> str:
    return name.split("_")[-1]


def _point(vertices: Array, joint: Array, bone: Array, turn: Array) -> Array:
    """Return offsets (V, 3) in metres for the skin that protrudes at a bent elbow."""
    along = bone / np.linalg.norm(bone)
    away = along - turn @ along
    fold = float(np.linalg.norm(away))
    if fold < 1e-6:
        return np.zeros_like(vertices)
    skin = vertices[np.linalg.norm(vertices - joint, axis=1) < 0.06]
    behind = skin[((skin - joint) @ -(turn @ along)).argmax()] if fold > 0.3 else joint
    share = np.exp(-0.5 * np.square(np.linalg.norm(vertices - behind, axis=1) / _POINT_WIDTH_M))
    return (min(1.0, fold / np.sqrt(2.0)) ** 2 * _POINT_M * share)[:, None] * away / fold
