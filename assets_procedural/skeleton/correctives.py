"""Compute pose correctives per joint from dual-quaternion skinning and preserved volume.

One joint rotates at a time. The wanted rest offset is dual-quaternion skinning (Kavan et al. 2007) minus linear
blending. At hips, knees and elbows, stretched skin also swells to restore the rest volume. Under a raised arm, the skin
is taut between ribs and arm, without the arc that dual quaternions would give. In the crook of an elbow, the skin ends
where both sides meet. The wanted offset is regressed on ``flatten(R_j - I)``, and masked to skin that both sides of the
joint move.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

from assets_procedural.arrays import FLIP, Array, averaging, neighbour_graph, table
from assets_procedural.layout import CHILDREN, JOINT, MIRROR_JOINT, PARENTS
from assets_procedural.skeleton.skinning import linear_blend, pose_skeleton, vertex_areas, vertex_normals, volume
from solver_backend.body.kinematics import subtree_matrix
from solver_backend.types import SMPL_JOINTS

Wanted = Callable[[int, Array], Array]  # Returns rest offsets (V, 3) in metres for a joint's rotation (3, 3).
NUM_FEATURES = 9 * (len(PARENTS) - 1)
_RIDGE, _SMALLEST_M, _MASK_FULL = 0.3, 5e-5, 0.08
_SLIGHT_M = 1.5e-4  # Smaller correctives are removed, because each row takes 116 bytes.
_LEFT_OUT = ("hand",)  # Joints without correctives. All fingers bend together, and no solve moves them.
_BULGING_JOINTS, _BULGE = ("shoulder",), 0.15  # Fraction of the dual quaternions' bulge that is removed
_RAISED_FROM, _RAISED = 0.35, 0.9  # Sines of the angles from which an arm is partly raised, and fully raised.
_TAUT_ROUNDS, _TAUT_FROM, _TAUT_AT = 12, 1.05, 1.5  # Smoothing steps, and growth from which skin tightens, and is taut.
_TOUCHING_JOINTS = ("elbow",)
_SWELLING_JOINTS, _LARGEST_SWELLING_M = ("hip", "knee", "elbow"), 0.025
Bends = dict[str, tuple[tuple[float, float, float], float, float]]  # Axis of a left joint, smallest and largest angle.
SECOND_BEND: Bends = {"left_shoulder": ((0.0, -1.0, 0.0), -0.4, 2.2)}  # forwards, in every second sample
_SPREAD_RAD = {"hip": 0.35, "shoulder": 0.6, "elbow": 0.35, "wrist": 0.4, "collar": 0.2, "head": 0.35, "neck": 0.3}
"""Standard deviation of each joint's sampled rotations in radians. Chosen by hand."""
_OTHER_SPREAD_RAD = 0.18  # Standard deviation of all other joints.


def sample_turns(name: str, count: int, rng: np.random.Generator, second: Bends = SECOND_BEND) -> Array:
    """Sample rotation vectors (count, 3) in a joint's range. Every second sample bends the joint as in ``second``."""
    part = name.split("_")[-1]
    vectors = rng.normal(size=(count, 3)) * _SPREAD_RAD.get(part, _OTHER_SPREAD_RAD)
    key = name.replace("right", "left")
    if key in table("main_bends"):
        flip = np.array([1.0, -1.0, -1.0] if name.startswith("right") else [1.0, 1.0, 1.0])
        axis, low, high = table("main_bends")[key]
        bends = rng.uniform(low, high, (count, 1)) * np.array(axis) * flip
        if key in second:
            axis, low, high = second[key]
            bends[1::2] = rng.uniform(low, high, (count // 2, 1)) * np.array(axis) * flip
        vectors += bends
    return vectors


def sample_poses(count: int, seed: int) -> Array:
    """Return local rotations (count, 24, 3, 3) of all joints. The root does not rotate."""
    rng = np.random.default_rng(seed)
    vectors = np.zeros((count, len(PARENTS), 3))
    for name, j in JOINT.items():
        if j > 0:
            vectors[:, j] = sample_turns(name, count, rng)
    return Rotation.from_rotvec(vectors.reshape(-1, 3)).as_matrix().reshape(count, -1, 3, 3)


def pose_features(rotations: Array) -> Array:
    """Return the pose features (N, 207), ``flatten(R_j - I)`` for j = 1..23, row-major."""
    return (rotations[:, 1:] - np.eye(3)).reshape(len(rotations), -1)


def dual_quaternion_blend(vertices: Array, weights: Array, turns: Array, shifts: Array) -> Array:
    """Blend vertices (V, 3) by the bones' dual quaternions, with signs that match each vertex's strongest bone."""
    real = Rotation.from_matrix(turns).as_quat()
    dual = _dual_part(real, shifts)
    strongest = real[weights.argmax(axis=1)]
    signed = weights * np.where(strongest @ real.T < 0, -1.0, 1.0)
    q, d = signed @ real, signed @ dual
    length = np.linalg.norm(q, axis=1, keepdims=True)
    q, d = q / length, d / length
    shift = 2.0 * (q[:, 3:] * d[:, :3] - d[:, 3:] * q[:, :3] + np.cross(q[:, :3], d[:, :3]))
    return Rotation.from_quat(q).apply(vertices) + shift


def _dual_part(real: Array, shifts: Array) -> Array:
    """Return the dual part: half the product of the shift (as a pure quaternion) and the rotation (x, y, z, w)."""
    vector = real[:, 3:] * shifts + np.cross(shifts, real[:, :3])
    return 0.5 * np.concatenate([vector, -np.sum(shifts * real[:, :3], axis=1, keepdims=True)], axis=1)


def rest_differences(vertices: Array, weights: Array, joints: Array, rotations: Array) -> Array:
    """Return rest offsets (N, V, 3) in metres. With them, linear blending matches dual-quaternion blending."""
    out = np.zeros((len(rotations), *vertices.shape), dtype=np.float32)
    mixed = np.nonzero(weights.max(axis=1) < 0.999)[0]
    for n, local in enumerate(rotations):
        turns, shifts = pose_skeleton(joints, local)
        target = dual_quaternion_blend(vertices[mixed], weights[mixed], turns, shifts)
        out[n, mixed] = to_rest(target, vertices[mixed], weights[mixed], turns, shifts)
    return out


def to_rest(target: Array, vertices: Array, weights: Array, turns: Array, shifts: Array) -> Array:
    """Return rest offsets (V, 3) that move linearly blended vertices to a target. They are damped where skin folds."""
    blend = (weights @ turns.reshape(-1, 9)).reshape(-1, 3, 3)
    gap = target - linear_blend(vertices, weights, turns, shifts)
    normal = np.einsum("vba,vbc->vac", blend, blend) + 0.02 * np.eye(3)
    return np.linalg.solve(normal, np.einsum("vba,vb->va", blend, gap)[..., None])[..., 0]


def joint_masks(weights: Array, parents: tuple[int, ...] = PARENTS) -> Array:
    """Return masks (V, J - 1) of the skin at each joint: 1 where bones on both sides have weight, 0 far away."""
    beyond = weights @ subtree_matrix(parents)[1:].T
    t = (np.minimum(beyond, 1.0 - beyond) / _MASK_FULL).clip(0.0, 1.0)
    return np.where(t < 1e-3, 0.0, t * t * (3.0 - 2.0 * t))


def fit_correctives(
    vertices: Array, faces: Array, weights: Array, joints: Array, mirror: Array, *, count: int = 48, seed: int = 0
) -> Array:
    """Return pose correctives (V, 3, 207) in metres, fitted to ``count`` poses per joint."""
    masks = joint_masks(weights)

    def wanted(joint: int, turn: Array) -> Array:
        return _wanted_offsets(vertices, faces, weights, joints, masks[:, joint - 1], joint, turn)

    chosen = tuple(name for name in SMPL_JOINTS if not name.endswith(_LEFT_OUT))
    return fit_by_joint(chosen, masks, mirror, wanted, count=count, seed=seed)


def fit_by_joint(
    names: tuple[str, ...],
    masks: Array,
    mirror: Array,
    wanted: Wanted,
    *,
    second: Bends = SECOND_BEND,
    count: int = 48,
    seed: int = 0,
) -> Array:
    """Fit correctives (V, 3, 207) that give the wanted rest offsets if only one joint rotates.

    Args:
        names: joints to fit. Each right joint mirrors its left one.
        masks: (V, 23) weights of each joint's correctives.
        mirror: (V,) index of the vertex on the other side.
        wanted: function of a joint and its (3, 3) rotation that returns (V, 3) offsets in metres.
        second: bends to use in every second sample.
        count: number of sampled rotations per joint.
        seed: seed of the samples.
    """
    rng = np.random.default_rng(seed)
    directions = np.zeros((len(masks), 3, NUM_FEATURES))
    for name, j in JOINT.items():
        if j == 0 or name.startswith("right") or name not in names:
            continue
        turns = Rotation.from_rotvec(sample_turns(name, count, rng, second)).as_matrix()
        offsets = np.stack([wanted(j, R) for R in turns])
        directions[:, :, 9 * (j - 1) : 9 * j] = fit_to_turns(turns, offsets, _RIDGE, masks[:, j - 1])
    other = _mirrored(directions, mirror)
    for name, j in JOINT.items():
        block = slice(9 * (j - 1), 9 * j)
        if name.startswith("right"):
            directions[:, :, block] = other[:, :, block]
        elif j > 0 and not name.startswith("left"):
            directions[:, :, block] = 0.5 * (directions[:, :, block] + other[:, :, block])
    return without_slight(directions)


def without_slight(directions: Array) -> Array:
    """Set correctives (V, 3, 207) to 0 where a joint moves a vertex by less than 0.15 mm, or a value is tiny."""
    blocks = directions.reshape(len(directions), 3, -1, 9)
    slight = np.sqrt(np.square(blocks).sum(axis=1)).max(axis=2) < _SLIGHT_M
    directions = np.where(slight[:, None, :, None], 0.0, blocks).reshape(directions.shape)
    return np.where(np.abs(directions) < _SMALLEST_M, 0.0, directions)


def fit_to_turns(turns: Array, wanted: Array, ridge: float, mask: Array) -> Array:
    """Fit masked correctives (N, 3, 9) per unit of ``flatten(R - I)`` to offsets (P, N, 3) at P rotations R."""
    features = (turns - np.eye(3)).reshape(len(turns), 9)
    gram = features.T @ features + ridge * np.eye(9)
    fitted = np.linalg.solve(gram, features.T @ wanted.reshape(len(turns), -1)).reshape(9, -1, 3)
    return np.transpose(fitted, (1, 2, 0)) * mask[:, None, None]


def _wanted_offsets(
    vertices: Array, faces: Array, weights: Array, joints: Array, mask: Array, joint: int, turn: Array
) -> Array:
    local = np.tile(np.eye(3), (len(PARENTS), 1, 1))
    local[joint] = turn
    turns, shifts = pose_skeleton(joints, local)
    target = dual_quaternion_blend(vertices, weights, turns, shifts)
    if SMPL_JOINTS[joint].endswith(_BULGING_JOINTS):
        raised = float(np.clip((turn[1, 0] - _RAISED_FROM) / (_RAISED - _RAISED_FROM), 0.0, 1.0))
        share = _BULGE + (1.0 - _BULGE) * raised
        target = target + share * (linear_blend(vertices, weights, turns, shifts) - target)
        target = _taut(vertices, target, faces, raised * mask)
    if SMPL_JOINTS[joint].endswith(_TOUCHING_JOINTS):
        target = parted(vertices, target, joints[joint], joints[CHILDREN[joint][0]] - joints[joint], turn, mask)
    if SMPL_JOINTS[joint].endswith(_SWELLING_JOINTS):
        target = target + swelling(vertices, target, faces, mask)
    return masked_to_rest(mask, target, vertices, weights, turns, shifts)


def masked_to_rest(mask: Array, target: Array, vertices: Array, weights: Array, turns: Array, shifts: Array) -> Array:
    """Return the offsets of ``to_rest`` for vertices with a positive mask (V,), and 0 for all others."""
    out, chosen = np.zeros_like(vertices), mask > 0
    out[chosen] = to_rest(target[chosen], vertices[chosen], weights[chosen], turns, shifts)
    return out


def swelling(vertices: Array, posed: Array, faces: Array, mask: Array) -> Array:
    """Return offsets (V, 3) in metres that restore the rest volume by moving stretched skin along its normals."""
    areas = vertex_areas(posed, faces)
    share = mask * (areas / vertex_areas(vertices, faces) - 0.7).clip(0.0, 0.8)
    lost = volume(vertices, faces) - volume(posed, faces)
    amount = lost / max(float(np.sum(share * areas)), 1e-9)
    limit = _LARGEST_SWELLING_M / max(float(share.max()), 1e-9)
    return (np.clip(amount, 0.0, limit) * share)[:, None] * vertex_normals(posed, faces)


def _taut(vertices: Array, posed: Array, faces: Array, share: Array) -> Array:
    """Move stretched vertices of the posed skin (V, 3) to the mean of their neighbours, weighted by ``share``."""
    stretch = vertex_areas(posed, faces) / vertex_areas(vertices, faces)
    pull = share * ((stretch - _TAUT_FROM) / (_TAUT_AT - _TAUT_FROM)).clip(0.0, 1.0)
    if not pull.any():
        return posed
    mean, drawn = averaging(neighbour_graph(faces, len(posed))), posed
    for _ in range(_TAUT_ROUNDS):
        drawn = drawn + pull[:, None] * (mean @ drawn - drawn)
    return drawn


def parted(vertices: Array, posed: Array, joint: Array, bone: Array, turn: Array, share: Array) -> Array:
    """Move posed vertices that have crossed the bisecting plane of a bend back to that plane.

    Args:
        vertices: (V, 3) rest vertices in metres.
        posed: (V, 3) vertices in metres with only one joint rotated.
        joint: (3,) position of the joint in metres.
        bone: (3,) vector from the joint to its child in metres.
        turn: (3, 3) rotation of the joint.
        share: (V,) weights.
    """
    bone = bone / np.linalg.norm(bone)
    halving = bone + turn @ bone
    halving = halving / np.linalg.norm(halving)
    side = np.sign((vertices - joint) @ bone)
    beyond = np.minimum(side * ((posed - joint) @ halving), 0.0)
    return posed - (share * side * beyond)[:, None] * halving


def _mirrored(directions: Array, mirror: Array) -> Array:
    """Mirror correctives: exchange left and right vertices and joints, and negate x."""
    blocks = directions[mirror].reshape(len(directions), 3, -1, 3, 3)
    order = [MIRROR_JOINT[j] - 1 for j in range(1, len(PARENTS))]
    turned = blocks[:, :, order] * FLIP[:, None] * FLIP
    return (turned * FLIP[:, None, None, None]).reshape(directions.shape)
