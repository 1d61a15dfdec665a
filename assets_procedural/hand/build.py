"""From the built body to the file of its hands."""

from __future__ import annotations

import numpy as np

from assets_procedural.arrays import Array
from assets_procedural.build import BODY_FILE, BuiltBody
from assets_procedural.hand.correctives import fit_hand_correctives, left_skeleton
from assets_procedural.hand.joints import HandJoints, place_hand_joints
from assets_procedural.hand.tree import FIRST, LEFT, MIRROR, PARENTS, WRIST
from assets_procedural.hand.weights import hand_weights
from assets_procedural.skeleton.regressor import fit_regressor
from solver_backend.body.hand_angles import ANGLES
from solver_backend.body.hands import COLUMNS, hand_size_directions

HANDS_FILE = BODY_FILE.with_name("hands_neutral.npz")
"""Beside the body file."""
_THUMB_SPREAD_DEG = 25.0
"""A flat hand's thumb lies beside the palm, a little below it."""


def build_hands(built: BuiltBody) -> dict[str, Array]:
    """Return the arrays of the hands' file, which adds finger joints to the body's.

    ``body_id``: whose hands they are; ``vertices`` (N,): the skin that fingers move or that shows where they are;
    ``weights`` (N, 52); ``J_regressor`` (30, N): of the finger joints; ``posedirs`` (N, 3, 270): of the finger joints;
    ``flat`` (30, 3, 3): rotations of finger bones from rest to a flat hand; ``tips`` (10, 3) metres: where fingers end.
    """
    arrays, names = built.arrays, ("v_template", "shapedirs", "weights", "J", "J_shapedirs")
    real = {name: arrays[name].astype(np.float64) for name in names}
    vertices, faces, mirror = real["v_template"], arrays["f"].astype(np.int64), arrays["mirror"].astype(np.int64)
    hands = place_hand_joints(real["J"], real["J_shapedirs"], built.knots, vertices, real["shapedirs"], faces)
    joints = hands.joints
    weights = hand_weights(vertices, faces, real["weights"], joints, hands.tips, mirror).astype(np.float32)
    size = hand_size_directions(vertices, weights.astype(np.float64), joints)
    joint_size = joints[FIRST:] - np.repeat(joints[[WRIST, MIRROR[WRIST]]], len(LEFT), axis=0)
    regressor = fit_regressor(
        vertices, np.concatenate([real["shapedirs"], size[..., None]], axis=2), joints[FIRST:],
        np.concatenate([hands.joint_dirs[FIRST:], joint_size[..., None]], axis=2), mirror,
        tuple(MIRROR[j] - FIRST for j in range(FIRST, len(PARENTS))),
    )  # fmt: skip
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
    """Return (30, 3, 3) rotations from rest to a flat hand, of each finger bone as a whole, in SMPL-H's order.

    Args:
        hands: rest joints and fingertips.
    """
    skeleton = left_skeleton(hands)
    angles = skeleton.rest_angles.copy()
    angles[[name.endswith("flexion") for name in ANGLES]] = 0.0
    angles[ANGLES.index("thumb_cmc_spread")] = np.radians(_THUMB_SPREAD_DEG)
    turned = (skeleton.pose(angles[None]).frames[0, :, 1:] @ np.swapaxes(skeleton.rest, -1, -2)).reshape(-1, 3, 3)
    left = np.zeros_like(turned)
    left[np.array(COLUMNS).ravel()] = turned
    flip = np.array([-1.0, 1.0, 1.0])
    return np.concatenate([left, left * flip[:, None] * flip])
