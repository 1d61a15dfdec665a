"""Compute the rest joints of the fingers: knuckles from knots, other joints from the finger's centre."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from assets_procedural.arrays import FLIP, Array, part_of
from assets_procedural.detail.fingers import DIGITS, relaxed_knots
from assets_procedural.skeleton.skinning import MAX_INFLUENCES, distance_to_segment, heat_shares
from solver_backend.exchange.body_layout import SMPL_FINGERS, SMPL_HANDS

PARENTS, MIRROR = SMPL_HANDS.parents, SMPL_HANDS.mirror  # Parent and mirror image of each of the 52 joints.
LEFT = SMPL_HANDS.group("left_hand")  # Finger joints of the left hand. They follow SMPL's joints.
FIRST, WRIST, PER_FINGER = LEFT[0], SMPL_HANDS.joints.index("left_wrist"), 3


def left_bones(joints: Array, tips: Array) -> dict[int, list[tuple[Array, Array]]]:
    """Return the bones of the left wrist and finger joints, as (start, end)."""
    ends = {j: joints[j + 1] for j in LEFT if (j - FIRST) % PER_FINGER < PER_FINGER - 1}
    ends |= {LEFT[PER_FINGER * k + PER_FINGER - 1]: tip for k, tip in enumerate(tips)}
    bones = {WRIST: [(joints[WRIST], joints[knuckle]) for knuckle in LEFT[::PER_FINGER]]}
    return bones | {j: [(joints[j], ends[j])] for j in LEFT}


_DIGIT = {"pinky": "little"}  # Names that the generator uses for digits, where they differ from SMPL-H's.
_ROUNDS = 3  # Iterations that move joints to the centre of the section that bisects the bend between two bones.
_FREE_SKIN, _BESIDE_M = 0.65, 0.006  # Fraction of the first bone beyond the web, and largest movement of a knuckle.


@dataclass(frozen=True)
class HandJoints:
    """Joints of a body that has fingers, and the fingertips."""

    joints: Array  # (52, 3) metres.
    joint_dirs: Array  # (52, 3, C) metres per unit of C shapes.
    tips: Array  # (10, 3) metres: ends of the fingers, inside the skin, in SMPL-H's order.


@dataclass(frozen=True)
class Knots:
    """Knots of the relaxed fingers of both hands, starting with the thumb (see ``finger_knots``)."""

    points: Array  # (40, 3) metres.
    directions: Array  # (40, 3, 10) metres per unit of shape.

    @classmethod
    def relaxed(cls, spread: Array, directions: Array) -> Knots:
        """Return the relaxed knots, given the knots (40, 3) of spread fingers and their shape directions."""
        return cls(relaxed_knots(spread[..., None])[..., 0], relaxed_knots(directions))


def place_hand_joints(
    joints: Array, joint_dirs: Array, knots: Knots, vertices: Array, dirs: Array, faces: Array
) -> HandJoints:
    """Return the joints of the body and its fingers at rest, and how they change with the shape."""
    left, left_dirs = _in_order(knots.points), _in_order(knots.directions)
    centres = np.zeros((len(left), len(vertices)))
    moved = np.isin(np.arange(len(left)) % 4, (1, 2))
    for _ in range(_ROUNDS):
        for k in np.flatnonzero(moved):
            along = _unit(left[k + 1] - left[k]) + _unit(left[k] - left[k - 1])
            centres[k] = section_centre(vertices, faces, left[k], along)
        left[moved] = centres[moved] @ vertices
    left_dirs[moved] = np.tensordot(centres[moved], dirs, axes=(1, 0))
    for k in np.flatnonzero(np.arange(len(left)) % 4 == 0):
        place, along = left[k] + _FREE_SKIN * (left[k + 1] - left[k]), _unit(left[k + 1] - left[k])
        centre = section_centre(vertices, faces, place, along)
        shift = centre @ vertices - place
        # Where palm skin surrounds the bone, no part of its section belongs to the finger.
        if np.linalg.norm(shift) < _BESIDE_M:
            place_dirs = left_dirs[k] + _FREE_SKIN * (left_dirs[k + 1] - left_dirs[k])
            left[k], left_dirs[k] = left[k] + shift, left_dirs[k] + np.tensordot(centre, dirs, axes=1) - place_dirs
    is_joint = np.arange(len(left)) % 4 < PER_FINGER
    found, found_dirs = np.zeros((len(MIRROR), 3)), np.zeros((len(MIRROR), 3, dirs.shape[2]))
    found[:FIRST], found_dirs[:FIRST] = joints[:FIRST], joint_dirs[:FIRST]
    for side in (list(LEFT), [MIRROR[j] for j in LEFT]):
        flip = np.ones(3) if side[0] == FIRST else FLIP
        found[side], found_dirs[side] = left[is_joint] * flip, left_dirs[is_joint] * flip[:, None]
    return HandJoints(found, found_dirs, np.concatenate([left[~is_joint], left[~is_joint] * FLIP]))


def _in_order(values: Array) -> Array:
    names = list(DIGITS)
    order = [names.index(_DIGIT.get(finger, finger)) for finger in SMPL_FINGERS]
    digits = values[: len(values) // 2].reshape(len(names), 4, *values.shape[1:])
    return digits[order].reshape(-1, *values.shape[1:])


def _unit(vector: Array) -> Array:
    return vector / np.linalg.norm(vector)


def section_centre(vertices: Array, faces: Array, near: Array, normal: Array) -> Array:
    """Return vertex weights (V,) that sum to 1 and give the centre of a plane section's outline.

    Of several outlines, the one with its centre nearest to ``near`` (a (3,) point in the plane) is used.
    """
    height = (vertices - near) @ normal
    crossing = (height[faces] > 0).any(axis=1) & (height[faces] <= 0).any(axis=1)
    cut = faces[crossing]
    pairs = np.sort(np.stack([cut, np.roll(cut, -1, axis=1)], axis=-1), axis=-1)
    through = (height[pairs[..., 0]] > 0) != (height[pairs[..., 1]] > 0)
    edges = pairs[through].reshape(-1, 2, 2)
    _, number = np.unique(edges.reshape(-1, 2), axis=0, return_inverse=True)
    ends = number.reshape(-1, 2)
    count = ends.max() + 1
    loops = connected_components(sp.csr_matrix((np.ones(len(ends)), ends.T), shape=(count, count)), directed=False)[1]
    t = height[edges[..., 0]] / (height[edges[..., 0]] - height[edges[..., 1]])
    points = vertices[edges[..., 0]] * (1 - t)[..., None] + vertices[edges[..., 1]] * t[..., None]
    length, middle, loop = np.linalg.norm(points[:, 0] - points[:, 1], axis=1), points.mean(axis=1), loops[ends[:, 0]]
    total = np.bincount(loop, length)
    centres = np.stack([np.bincount(loop, length * middle[:, a]) for a in range(3)], axis=1) / total[:, None]
    chosen = int(np.linalg.norm(centres - near, axis=1).argmin())
    share = np.where(loop == chosen, length, 0.0)[:, None] / (2 * total[chosen])
    weights = np.zeros(len(vertices))
    np.add.at(weights, edges[..., 0], share * (1 - t))
    np.add.at(weights, edges[..., 1], share * t)
    return weights


_SMALLEST = 0.01  # Smallest weight that a bone keeps.
_BONES = 4  # Largest number of hand bones per vertex, as in glTF and game engines.


def hand_weights(vertices: Array, faces: Array, weights: Array, joints: Array, tips: Array, mirror: Array) -> Array:
    """Return skinning weights (V, 52) of a body with fingers, given its weights without fingers."""
    out = np.zeros((len(vertices), len(joints)))
    out[:, :FIRST] = weights[:, :FIRST]
    carried = weights[:, WRIST] + weights[:, FIRST]
    chosen = np.nonzero(carried)[0]
    points, own = vertices[chosen], part_of(faces, chosen, len(vertices))
    bones = left_bones(joints, tips[:5]).values()
    distance = np.stack([np.min([distance_to_segment(points, *s) for s in segments], 0) for segments in bones])
    shares = heat_shares(points, own, distance)
    others = np.count_nonzero(weights[chosen], axis=1) - np.count_nonzero(weights[chosen][:, [WRIST, FIRST]], axis=1)
    shares = _keep_strongest(shares, np.minimum(_BONES, MAX_INFLUENCES - others))
    left = np.array([WRIST, *LEFT])
    out[chosen[:, None], left] = carried[chosen, None] * shares
    out[mirror[chosen][:, None], np.array(MIRROR)[left]] = out[chosen[:, None], left]
    return out


def _keep_strongest(shares: Array, most: Array) -> Array:
    shares = np.where(shares < _SMALLEST, 0.0, shares - _SMALLEST)
    limit = np.take_along_axis(-np.sort(-shares, axis=1), most[:, None], axis=1)
    kept = np.where(shares > limit, shares, 0.0)
    return kept / kept.sum(axis=1, keepdims=True)
