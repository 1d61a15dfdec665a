"""Build the hands file from the built body."""

from __future__ import annotations

import numpy as np

from assets_procedural.arrays import FLIP, Array, part_of, table
from assets_procedural.build import BODY_FILE, BuiltBody
from assets_procedural.hand.joints import (
    FIRST,
    LEFT,
    MIRROR,
    PARENTS,
    PER_FINGER,
    WRIST,
    HandJoints,
    hand_weights,
    place_hand_joints,
)
from assets_procedural.skeleton.correctives import (
    dual_quaternion_blend,
    fit_to_turns,
    joint_masks,
    masked_to_rest,
    parted,
    swelling,
)
from assets_procedural.skeleton.skinning import fit_regressor, pose_skeleton
from solver_backend.body.hand_skeleton import ANGLES, FINGER_OF, JOINT_OF, HandSkeleton
from solver_backend.body.hands import COLUMNS, hand_size_directions
from solver_backend.exchange.body_layout import SMPL_FINGERS
from solver_backend.exchange.joint_sets import FINGERS

_RIDGE, _SMALLEST_M = 0.1, 5e-5  # Ridge parameter of the fit, and size in metres below which correctives are 0.
_COUNT = 48  # Number of poses sampled per joint.


def fit_hand_correctives(vertices: Array, faces: Array, weights: Array, hands: HandJoints, mirror: Array) -> Array:
    """Return correctives (V, 3, 270) for the finger joints, in metres per unit of ``flatten(R_j - I)``."""
    masks = joint_masks(weights, PARENTS)[:, FIRST - 1 :]
    turns, rng = left_skeleton(hands), np.random.default_rng(0)
    directions = np.zeros((len(vertices), 3, 2, len(LEFT), 9))
    chosen = np.flatnonzero(weights[:, [WRIST, *LEFT]].any(axis=1))
    # The piece ends at the forearm, which no finger moves, so its volume changes by as much as the whole body's.
    piece = (vertices[chosen], part_of(faces, chosen, len(vertices)), weights[chosen])
    for k, j in enumerate(LEFT):
        bone = hands.joints[j] - hands.joints[j - 1] if k % PER_FINGER == PER_FINGER - 1 else None
        bone = hands.joints[j + 1] - hands.joints[j] if bone is None else bone
        sampled = sample_turns(turns, k, rng)
        mask = masks[chosen, k]
        wanted = np.stack([_wanted(*piece, hands.joints, j, bone, mask, turn) for turn in sampled])
        directions[chosen, :, 0, k] = fit_to_turns(sampled, wanted, _RIDGE, mask)
    directions = np.where(np.abs(directions) < _SMALLEST_M, 0.0, directions)
    # For the mirror image, x changes its sign, and R becomes S R S with S = diag(-1, 1, 1).
    sign = FLIP[:, None, None] * (FLIP[:, None] * FLIP).ravel()
    directions[mirror, :, 1] = directions[:, :, 0] * sign
    return directions.reshape(len(vertices), 3, -1)


def sample_turns(skeleton: HandSkeleton, joint: int, rng: np.random.Generator) -> Array:
    """Sample local rotations (N, 3, 3) over the range of a left-hand joint, numbered in SMPL-H's order."""
    finger = FINGERS.index(SMPL_FINGERS[joint // PER_FINGER])
    angles = np.tile(skeleton.rest_angles, (_COUNT, 1))
    for i in np.flatnonzero((finger == FINGER_OF) & (joint % PER_FINGER == JOINT_OF)):
        ranges = table("finger_ranges_deg")
        name = ANGLES[i] if ANGLES[i] in ranges else ANGLES[i].split("_", 1)[1]
        low, high = ranges[name]
        angles[:, i] = np.radians(rng.uniform(low, high, _COUNT))
    return skeleton.local_rotations(angles)[:, finger, joint % PER_FINGER]


def left_skeleton(hands: HandJoints) -> HandSkeleton:
    """Return the skeleton of the left hand, starting with the thumb."""
    chains = np.concatenate([hands.joints[list(LEFT)].reshape(5, 3, 3), hands.tips[:5, None]], axis=1)
    order = [SMPL_FINGERS.index(finger) for finger in FINGERS]
    return HandSkeleton.of_points(np.concatenate([hands.joints[[WRIST]], chains[order].reshape(-1, 3)]), 0)


def _wanted(
    vertices: Array, faces: Array, weights: Array, joints: Array, joint: int, bone: Array, mask: Array, turn: Array
) -> Array:
    local = np.tile(np.eye(3), (len(PARENTS), 1, 1))
    local[joint] = turn
    turns, shifts = pose_skeleton(joints, local, PARENTS)
    target = dual_quaternion_blend(vertices, weights, turns, shifts)
    target = parted(vertices, target, joints[joint], bone, turn, mask)
    target = target + swelling(vertices, target, faces, mask)
    return masked_to_rest(mask, target, vertices, weights, turns, shifts)


HANDS_FILE = BODY_FILE.with_name("hands_neutral.npz")  # File that is stored next to the body file.
_THUMB_SPREAD_DEG = 25.0  # Angle of the thumb in a flat hand. The thumb is slightly below the palm.


def build_hands(built: BuiltBody) -> dict[str, Array]:
    """Return the arrays of the hands file, which adds finger joints to the body.

    - ``body_id``: the body that these hands belong to
    - ``vertices`` (N,): vertices that the fingers move, or that their joints are computed from
    - ``weights`` (N, 52), and for the finger joints ``J_regressor`` (30, N) and ``posedirs`` (N, 3, 270)
    - ``flat`` (30, 3, 3): rotations of finger bones from rest to a flat hand
    - ``tips`` (10, 3): ends of the fingers in metres
    """
    arrays, names = built.arrays, ("v_template", "shapedirs", "weights", "J", "J_shapedirs")
    real = {name: arrays[name].astype(np.float64) for name in names}
    vertices, faces, mirror = real["v_template"], arrays["f"].astype(np.int64), arrays["mirror"].astype(np.int64)
    hands = place_hand_joints(real["J"], real["J_shapedirs"], built.knots, vertices, real["shapedirs"], faces)
    joints = hands.joints
    weights = hand_weights(vertices, faces, real["weights"], joints, hands.tips, mirror).astype(np.float32)
    size = hand_size_directions(vertices, weights.astype(np.float64), joints)
    joint_size = joints[FIRST:] - np.repeat(joints[[WRIST, MIRROR[WRIST]]], len(LEFT), axis=0)
    dirs = np.concatenate([real["shapedirs"], size[..., None]], axis=2)
    joint_dirs = np.concatenate([hands.joint_dirs[FIRST:], joint_size[..., None]], axis=2)
    other = tuple(MIRROR[j] - FIRST for j in range(FIRST, len(PARENTS)))
    regressor = fit_regressor(vertices, dirs, joints[FIRST:], joint_dirs, mirror, other)
    posedirs = fit_hand_correctives(vertices, faces, weights.astype(np.float64), hands, mirror)
    chosen = np.nonzero((weights[:, FIRST:].sum(axis=1) > 0) | (regressor != 0).any(axis=0))[0]
    return {
        "body_id": arrays["body_id"],
        "vertices": chosen.astype(np.uint32),
        "weights": weights[chosen],
        "J_regressor": regressor[:, chosen].astype(np.float32),
        "posedirs": posedirs[chosen].astype(np.float16),
        "flat": flat_rotations(hands).astype(np.float32),
        "tips": hands.tips.astype(np.float32),
    }


def flat_rotations(hands: HandJoints) -> Array:
    """Return the global rotations (30, 3, 3) of the finger bones from rest to a flat hand, in SMPL-H's order."""
    skeleton = left_skeleton(hands)
    angles = skeleton.rest_angles.copy()
    angles[[name.endswith("flexion") for name in ANGLES]] = 0.0
    angles[ANGLES.index("thumb_cmc_spread")] = np.radians(_THUMB_SPREAD_DEG)
    turned = (skeleton.pose(angles[None]).frames[0, :, 1:] @ np.swapaxes(skeleton.rest, -1, -2)).reshape(-1, 3, 3)
    left = np.zeros_like(turned)
    left[np.array(COLUMNS).ravel()] = turned
    return np.concatenate([left, left * FLIP[:, None] * FLIP])
