"""Add finger joints to bodies: the built-in body with its hands file, SMPL-H and SMPL-X."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from solver_backend.body.body import DEFAULT_BODY, Body, load_body
from solver_backend.body.hand_skeleton import HandSkeleton
from solver_backend.exchange.body_layout import SMPL_FINGERS, SMPL_H, SMPL_HANDS
from solver_backend.exchange.errors import BodyInvalid
from solver_backend.exchange.finger_joints import (
    FIRST_FINGER,
    HANDS_FILE,
    HANDS_KEYS,
    Skinning,
    needs_hands_file,
    with_finger_joints,
)
from solver_backend.exchange.joint_sets import FINGERS, SIDES
from solver_backend.exchange.npz import read_npz
from solver_backend.types.shapes import Float, Int

__all__ = [
    "FIRST_FINGER",
    "flat_hands",
    "hand_size_directions",
    "load_body_with_hands",
    "with_fingers",
    "with_hand_size",
]

_NUM_FINGERS = SMPL_HANDS.num_joints - FIRST_FINGER  # Number of finger joints in both hands.


def load_body_with_hands() -> Body:
    """Read the built-in body with finger joints (layout ``SMPL_HANDS``)."""
    return with_fingers(load_body())


@lru_cache(maxsize=4)
def with_fingers(body: Body) -> Body:
    """Add finger joints to a body. The skin, shapes and body joints do not change.

    Raises:
        BodyInvalid: the body has no fingers and is not the built-in one.
    """
    hands = _hands_file() if needs_hands_file(body.layout) else None
    skinning = with_finger_joints(body.layout, Skinning(body.weights, body.J_regressor, body.posedirs), body.id, hands)
    parents = body.layout.parents if body.layout.joints == SMPL_H.joints else SMPL_HANDS.parents
    parts = {name: getattr(skinning, name) for name in ("weights", "J_regressor", "posedirs")}
    return replace(body, **parts, layout=replace(SMPL_HANDS, parents=parents), hands_mean=None)


def flat_hands(body: Body) -> Float[np.ndarray, "30 3 3"]:
    """Return (30, 3, 3) finger rotations from rest to a flat hand, which is the zero pose of AMASS."""
    own = body.id == str(_hands_file()["body_id"])
    return _hands_file()["flat"].astype(np.float64) if own else np.tile(np.eye(3), (_NUM_FINGERS, 1, 1))


def with_hand_size(body: Body, size: float) -> Body:
    """Scale a body's hands: ``v + (size - 1) d`` with ``hand_size_directions`` d."""
    if not size > 0.0:
        raise BodyInvalid(f"The relative hand size is {size}, but a positive number is expected.", where=body.id)
    if size == 1.0:
        return body
    directions = hand_size_directions(body.v_template, body.weights, body.joints_template)
    return replace(body, v_template=body.v_template + (size - 1.0) * directions)


def hand_size_directions(
    vertices: Float[np.ndarray, "vertices 3"],
    weights: Float[np.ndarray, "vertices 52"],
    joints: Float[np.ndarray, "52 3"],
) -> Float[np.ndarray, "vertices 3"]:
    """Return the (V, 3) displacements of the vertices in metres per unit of relative hand size."""
    directions = np.zeros_like(vertices)
    for side in ("left", "right"):
        wrist = SMPL_HANDS.joints.index(f"{side}_wrist")
        share = weights[:, [wrist, *SMPL_HANDS.group(f"{side}_hand")]].sum(axis=1)
        # Smooth at both ends, so that there is no step between the forearm and a larger hand.
        directions += (share * share * (3.0 - 2.0 * share))[:, None] * (vertices - joints[wrist])
    return directions


@lru_cache(maxsize=1)
def _hands_file() -> dict[str, np.ndarray]:
    return read_npz(DEFAULT_BODY.with_name(HANDS_FILE), HANDS_KEYS.__contains__)


JOINTS_OF_A_HAND = len(SMPL_HANDS.group("left_hand"))  # Number of finger joints on one side.
COLUMNS: tuple[tuple[int, ...], ...] = tuple(  # A hand's finger joints in SMPL-H's order, by finger of ``FINGERS``.
    tuple(3 * SMPL_FINGERS.index(finger) + joint for joint in range(3)) for finger in FINGERS
)


@lru_cache(maxsize=8)
def hand_skeletons(body: Body) -> tuple[HandSkeleton, HandSkeleton]:
    """Return the left and right hand skeleton of a body with finger joints, for its mean shape."""
    left, right = (HandSkeleton.of_points(hand_points(body, side), side) for side in range(len(SIDES)))
    return left, right


def hand_of_shape(body: Body, betas: Float[np.ndarray, " 10"], side: int) -> HandSkeleton:
    """Return one hand skeleton of a body with finger joints, for (10,) shape coefficients."""
    return HandSkeleton.of_points(hand_points(body, side, betas), side)


def by_joint(values: np.ndarray) -> np.ndarray:
    """Reorder finger values (F, 5, 3, ...) by finger to SMPL-H's joint order (F, 15, ...)."""
    ordered = np.empty((len(values), JOINTS_OF_A_HAND, *values.shape[3:]), values.dtype)
    ordered[:, np.array(COLUMNS)] = values
    return ordered


def by_finger(values: np.ndarray) -> np.ndarray:
    """Reorder finger values (F, 15, ...) in SMPL-H's joint order to (F, 5, 3, ...) by finger."""
    return values[:, np.array(COLUMNS)]


def finger_rotations(body: Body, angles: Float[np.ndarray, "frames 2 a"]) -> Float[np.ndarray, "frames 30 3 3"]:
    """Convert angles (F, 2, A) in radians to rotations (F, 30, 3, 3) in SMPL-H's order.

    In both arrays, the left hand comes first.
    """
    found = np.zeros((len(angles), 2, JOINTS_OF_A_HAND, 3, 3))
    for side, skeleton in enumerate(hand_skeletons(body)):
        found[:, side, np.array(COLUMNS)] = skeleton.local_rotations(angles[:, side])
    return found.reshape(len(angles), -1, 3, 3)


def rest_angles(body: Body) -> Float[np.ndarray, "2 a"]:
    """Return the (2, A) finger angles of both hands at rest, in radians."""
    return np.stack([skeleton.rest_angles for skeleton in hand_skeletons(body)])


def hand_points(body: Body, side: int, betas: Float[np.ndarray, " 10"] | None = None) -> Float[np.ndarray, "21 3"]:
    """Return one hand's (21, 3) ``HAND_POINTS`` in metres on a body at rest, by default of mean shape."""
    rows, tips = _joints(side), tip_vertices(body)[side]
    joints, ends = body.joints_template[rows], body.v_template[tips]
    if betas is not None:
        joints, ends = joints + body.joints_shapedirs[rows] @ betas, ends + body.shapedirs[tips] @ betas
    chains = np.concatenate([joints[1:].reshape(5, 3, 3), ends[:, None]], axis=1)
    return np.concatenate([joints[:1], chains.reshape(-1, 3)])


@lru_cache(maxsize=8)
def tip_vertices(body: Body) -> Int[np.ndarray, "2 5"]:
    """Return (2, 5) fingertip vertices, which are farthest along each finger's last bone."""
    tips = np.zeros((len(SIDES), len(FINGERS)), dtype=int)
    for side in range(len(SIDES)):
        for finger, last in enumerate(_joints(side)[3::3]):
            way = body.joints_template[last] - body.joints_template[last - 1]
            share = body.weights[:, last]
            own = np.flatnonzero(share >= 0.5 * share.max())
            tips[side, finger] = own[(body.v_template[own] @ way).argmax()]
    return tips


def _joints(side: int) -> np.ndarray:
    first = FIRST_FINGER + JOINTS_OF_A_HAND * side
    return np.array([SMPL_HANDS.joints.index(f"{SIDES[side]}_wrist"), *(first + np.array(COLUMNS).ravel())])
