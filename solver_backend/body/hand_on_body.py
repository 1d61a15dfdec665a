"""The hands of a body: their skeletons at rest, their angles as rotations of the body's finger joints, their points."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.hand_skeleton import HandSkeleton
from solver_backend.body.hands import FIRST_FINGER
from solver_backend.exchange.body_layout import SMPL_FINGERS, SMPL_HANDS
from solver_backend.exchange.hand_points import FINGERS, SIDES
from solver_backend.types.shapes import Float, Int

JOINTS_OF_A_HAND = len(SMPL_HANDS.group("left_hand"))
"""Finger joints of one side."""
COLUMNS: tuple[tuple[int, ...], ...] = tuple(
    tuple(3 * SMPL_FINGERS.index(finger) + joint for joint in range(3)) for finger in FINGERS
)
"""Finger joints of a hand in SMPL-H's order, by finger of ``FINGERS``."""


@lru_cache(maxsize=8)
def hand_skeletons(body: Body) -> tuple[HandSkeleton, HandSkeleton]:
    """Return the left and the right hand of the mean shape; a body's rest frame is theirs.

    Args:
        body: of the layout ``SMPL_HANDS``.
    """
    left, right = (HandSkeleton.of_points(hand_points(body, side), side) for side in range(len(SIDES)))
    return left, right


def hand_of_shape(body: Body, betas: Float[np.ndarray, " 10"], side: int) -> HandSkeleton:
    """Return a hand of a person of this shape.

    Args:
        body: of the layout ``SMPL_HANDS``.
        betas: (10,).
        side: 0 left, 1 right.
    """
    return HandSkeleton.of_points(hand_points(body, side, betas), side)


def by_joint(values: np.ndarray) -> np.ndarray:
    """Return (F, 15, ...) values of a hand's joints in SMPL-H's order from (F, 5, 3, ...) by finger of ``FINGERS``."""
    ordered = np.empty((len(values), JOINTS_OF_A_HAND, *values.shape[3:]), values.dtype)
    ordered[:, np.array(COLUMNS)] = values
    return ordered


def by_finger(values: np.ndarray) -> np.ndarray:
    """Return (F, 5, 3, ...) values by finger of ``FINGERS`` from (F, 15, ...) of a hand's joints in SMPL-H's order."""
    return values[:, np.array(COLUMNS)]


def finger_rotations(body: Body, angles: Float[np.ndarray, "frames 2 a"]) -> Float[np.ndarray, "frames 30 3 3"]:
    """Return (F, 30, 3, 3) local rotations of the finger joints, in SMPL-H's order.

    Args:
        body: of the layout ``SMPL_HANDS``.
        angles: (F, 2, A) radians of the left and the right hand, see ``hand_angles``.
    """
    found = np.zeros((len(angles), 2, JOINTS_OF_A_HAND, 3, 3))
    for side, skeleton in enumerate(hand_skeletons(body)):
        found[:, side, np.array(COLUMNS)] = skeleton.local_rotations(angles[:, side])
    return found.reshape(len(angles), -1, 3, 3)


def rest_angles(body: Body) -> Float[np.ndarray, "2 a"]:
    """Return (2, A) radians of the hands at rest."""
    return np.stack([skeleton.rest_angles for skeleton in hand_skeletons(body)])


def hand_points(body: Body, side: int, betas: Float[np.ndarray, " 10"] | None = None) -> Float[np.ndarray, "21 3"]:
    """Return (21, 3) of ``HAND_POINTS`` at rest, metres in the body's frame.

    Args:
        body: of the layout ``SMPL_HANDS``.
        side: 0 left, 1 right.
        betas: (10,) shape; the mean's if None.
    """
    rows, tips = _joints(side), tip_vertices(body)[side]
    joints, ends = body.joints_template[rows], body.v_template[tips]
    if betas is not None:
        joints, ends = joints + body.joints_shapedirs[rows] @ betas, ends + body.shapedirs[tips] @ betas
    chains = np.concatenate([joints[1:].reshape(5, 3, 3), ends[:, None]], axis=1)
    return np.concatenate([joints[:1], chains.reshape(-1, 3)])


@lru_cache(maxsize=8)
def tip_vertices(body: Body) -> Int[np.ndarray, "2 5"]:
    """Return (2, 5) the vertices at which fingers end: those of the last bones that lie furthest along them."""
    tips = np.zeros((len(SIDES), len(FINGERS)), dtype=int)
    for side in range(len(SIDES)):
        for finger, last in enumerate(_joints(side)[3::3]):
            way = body.joints_template[last] - body.joints_template[last - 1]
            share = body.weights[:, last]
            own = np.flatnonzero(share >= 0.5 * share.max())
            tips[side, finger] = own[(body.v_template[own] @ way).argmax()]
    return tips


def _joints(side: int) -> np.ndarray:
    """Return the joints of the wrist and of the fingers in the order of ``FINGERS``."""
    first = FIRST_FINGER + JOINTS_OF_A_HAND * side
    return np.array([SMPL_HANDS.joints.index(f"{SIDES[side]}_wrist"), *(first + np.array(COLUMNS).ravel())])
