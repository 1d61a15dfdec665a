"""Add correctives to the shown body, so that shoulders, elbows, hips and knees bend naturally.

The solver uses the body file's correctives, which do not change. The skin in Blender has a smoother target. The
linearly blended skin is smoothed over a few centimetres, like the rest skin. Then the difference between the rest skin
and its smoothed copy is added again in rotated frames (delta mush, Mancewicz, Derksen, Rijpkema and Wilson 2014).
Correctives are linear in the pose features, so they only approximate this target. Each further round poses the skin
with the correctives found so far, and fits the remaining differences: both sides of a bent elbow or knee end where they
touch, an arm at the side does not enter the ribs, and skin moves along smoothed gradients until volume and surface are
closer to the rest skin's.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu
from scipy.spatial import KDTree

from assets_procedural.arrays import Array, neighbour_graph, normal_sums, smooth_step
from assets_procedural.layout import CHILDREN, JOINT, PARENTS
from assets_procedural.skeleton.correctives import (
    SECOND_BEND,
    dual_quaternion_blend,
    fit_by_joint,
    joint_masks,
    masked_to_rest,
    parted,
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
from solver_backend.body.mesh import face_normals
from solver_backend.types import SMPL_JOINTS


class _Way(NamedTuple):
    """Parameters for the skin around a joint, chosen with ``tests.benchmarks.body_sheets`` and 24 random poses."""

    radius_m: float  # Radius of the smoothing.
    dual: float  # Share of dual-quaternion skinning in the target.
    volume: float  # Share of the lost volume that a round restores.
    surface: float = 0.0  # Share of the gained surface that a round removes.
    growth: tuple[float, float] = (0.0, 1e-9)  # Growth of area at which the swelling starts and is complete.


_WAYS = {
    "collar": _Way(0.040, 0.0, 0.0),
    "shoulder": _Way(0.040, 0.1, 0.6),
    "elbow": _Way(0.022, 0.0, 1.0),
    "hip": _Way(0.040, 0.7, 1.2, 0.2, (0.7, 1.5)),
    "knee": _Way(0.022, 1.0, 0.0),
}
"""Parameters of the joints that get further correctives."""
_SECOND = SECOND_BEND | {"left_hip": ((-0.74, 0.66, -0.12), 0.0, 2.3)}  # as in sitting cross-legged
_HINGES, _ROUNDS, _STEPS = ("elbow", "knee"), 3, 3  # Rounds of the fit, and Newton steps of a round.
_REACH = 0.02, 0.35  # Smoothed joint shares at which its shown correctives start and are complete.
_CONTACT_M = 0.1, 0.2  # Distances from the knee between which the correctives of touching thigh and calf fade.
_LARGEST_M = 0.03  # Maximum movement of a vertex in a Newton step.
_FAINT_M, _STEP_M = 8e-4, 2.0**-14  # Minimum size of a row, and rounding of its values. A row takes 57 bytes.
_POINT_M, _POINT_WIDTH_M = 0.010, 0.020  # Height and radius of a bent elbow's tip.
_PUSHES, _GAP_M = 4, 0.001  # Rounds that move an arm out of the ribs, and the gap that they leave.
_APART_M, _DEEPEST_M = 0.05, 0.03  # Skin closer than this at rest, or deeper inside, is not pushed.


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
        """Smooth vertex values (V, ...) on the mesh over the smoothing radius."""
        for _ in range(2):
            values = self._solve(self._mass @ values)
        return values

    def __call__(self, posed: Array) -> Array:
        """Return the posed skin (V, 3), smoothed and with the rest skin's details added."""
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
    """Return correctives (V, 3, 207) that Blender adds to ``posedirs``, in metres per unit of the pose features."""
    masks, wide = joint_masks(weights), np.zeros((len(vertices), len(PARENTS) - 1))
    mushes = {radius: DeltaMush(vertices, faces, radius) for radius in sorted({way.radius_m for way in _WAYS.values()})}
    names = tuple(name for name in SMPL_JOINTS if _kind(name) in _WAYS)
    for name in names:
        j, smooth = JOINT[name], mushes[_WAYS[_kind(name)].radius_m].smooth
        wide[:, j - 1] = smooth_step(smooth(masks[:, j - 1]), *_REACH)
        if _kind(name) == "knee":
            leg = weights[:, [PARENTS[j], j]].sum(axis=1) > 0.5
            near = 1.0 - smooth_step(np.linalg.norm(vertices - joints[j], axis=1), *_CONTACT_M)
            wide[:, j - 1] = np.maximum(wide[:, j - 1], leg * near)
    beyond = weights @ subtree_matrix(PARENTS).T > 0.5
    found = np.zeros_like(posedirs)

    def wanted(joint: int, turn: Array) -> Array:
        local = np.tile(np.eye(3), (len(PARENTS), 1, 1))
        local[joint] = turn
        bones, mask, kind = pose_skeleton(joints, local), wide[:, joint - 1], _kind(SMPL_JOINTS[joint])
        way, bone = _WAYS[kind], joints[CHILDREN[joint][0]] - joints[joint]
        mush, plain = mushes[way.radius_m], linear_blend(vertices, weights, *bones)
        if found.any():
            offsets = found[:, :, 9 * (joint - 1) : 9 * joint] @ (turn - np.eye(3)).ravel()
            start = target = linear_blend(vertices + offsets, weights, *bones)
        else:
            dual = dual_quaternion_blend(vertices, weights, *bones)
            start, target = plain, (1.0 - way.dual) * mush(plain) + way.dual * dual
            if kind == "elbow":
                target = target + _point(vertices, joints[joint], bone, turn)
        if kind in _HINGES:
            target = parted(vertices, target, joints[joint], bone, turn, mask)
        if kind == "shoulder":
            target = _pushed_out(vertices, target, faces, beyond[:, joint], mask)
        target = _restored(vertices, target, faces, mask, mush, way)
        return masked_to_rest(mask, plain + target - start, vertices, weights, *bones)

    for k in range(_ROUNDS):
        found = found + fit_by_joint(names, wide, mirror, wanted, second=_SECOND, seed=k)
    ours = np.repeat([_kind(name) in _WAYS for name in SMPL_JOINTS[1:]], 9)
    blocks = np.where(ours, found - posedirs, 0.0).reshape(len(vertices), 3, -1, 9)
    faint = np.linalg.norm(blocks, axis=1).max(axis=2) < _FAINT_M
    return (_STEP_M * np.round(np.where(faint[:, None, :, None], 0.0, blocks) / _STEP_M)).reshape(posedirs.shape)


def _restored(vertices: Array, posed: Array, faces: Array, mask: Array, mush: DeltaMush, way: _Way) -> Array:
    """Move skin along smoothed gradients to restore part of the rest volume and surface area (see ``way``)."""
    shares, rest_areas = np.array([way.volume, way.surface]), vertex_areas(vertices, faces)
    used = np.flatnonzero(shares)
    if not len(used):
        return posed

    def measure(skin: Array) -> Array:
        return np.array([volume(skin, faces), vertex_areas(skin, faces).sum()])

    goal = (1.0 - shares) * measure(posed) + shares * measure(vertices)
    for _ in range(_STEPS):
        areas = vertex_areas(posed, faces)
        gradients = np.stack([normal_sums(posed, faces) / 6.0, _area_gradient(posed, faces)])[used]
        stretched = mush.smooth(mask * smooth_step(areas / rest_areas, *way.growth)).clip(0.0)
        roots = np.sqrt([stretched, mask])[used, :, None]
        ways = [root * mush.smooth(root * g / areas[:, None]) for g, root in zip(gradients, roots, strict=True)]
        gains = np.einsum("iva,jva->ij", gradients, ways)
        gains += 1e-3 * np.diag(np.diag(gains))  # both ways are nearly the same where skin is round everywhere
        step = np.einsum("i,iva->va", np.linalg.solve(gains, (goal - measure(posed))[used]), ways)
        posed = posed + step * min(1.0, _LARGEST_M / max(float(np.linalg.norm(step, axis=1).max()), 1e-9))
    return posed


def _area_gradient(vertices: Array, faces: Array) -> Array:
    """Return the derivatives (V, 3) of the surface area by the vertex positions, in metres."""
    normals, out = face_normals(vertices, faces), np.zeros_like(vertices)
    normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-15)
    for k in range(3):
        opposite = vertices[faces[:, (k + 2) % 3]] - vertices[faces[:, (k + 1) % 3]]
        np.add.at(out, faces[:, k], 0.5 * np.cross(normals, opposite))
    return out


def _pushed_out(vertices: Array, posed: Array, faces: Array, beyond: Array, mask: Array) -> Array:
    """Move intersecting skin on the two sides of a joint apart, each side by half of the penetration depth."""
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
    """Return offsets (V, 3) in metres that form the point of a bent elbow."""
    along = bone / np.linalg.norm(bone)
    away = along - turn @ along
    fold = float(np.linalg.norm(away))
    if fold < 1e-6:
        return np.zeros_like(vertices)
    skin = vertices[np.linalg.norm(vertices - joint, axis=1) < 0.06]
    behind = skin[((skin - joint) @ -(turn @ along)).argmax()] if fold > 0.3 else joint
    share = np.exp(-0.5 * np.square(np.linalg.norm(vertices - behind, axis=1) / _POINT_WIDTH_M))
    return (min(1.0, fold / np.sqrt(2.0)) ** 2 * _POINT_M * share)[:, None] * away / fold
