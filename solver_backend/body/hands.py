"""Bodies whose fingers move: our own with its hands' file, SMPL-H's and SMPL-X's with face at rest."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from solver_backend.body.body import DEFAULT_BODY, Body, load_body
from solver_backend.exchange.body_layout import SMPL_H, SMPL_HANDS
from solver_backend.exchange.errors import BodyInvalid
from solver_backend.exchange.finger_joints import (
    FIRST_FINGER,
    HANDS_FILE,
    HANDS_KEYS,
    Skinning,
    needs_hands_file,
    with_finger_joints,
)
from solver_backend.exchange.npz import read_npz
from solver_backend.types.shapes import Float

__all__ = [
    "FIRST_FINGER",
    "flat_hands",
    "hand_size_directions",
    "load_body_with_hands",
    "with_fingers",
    "with_hand_size",
]

_NUM_FINGERS = SMPL_HANDS.num_joints - FIRST_FINGER
"""Finger joints of both hands."""


def load_body_with_hands() -> Body:
    """Read our body with fingers that move, of the layout ``SMPL_HANDS``.

    Raises:
        BodyInvalid: see ``load_body`` and ``with_fingers``.
    """
    return with_fingers(load_body())


@lru_cache(maxsize=4)
def with_fingers(body: Body) -> Body:
    """Return the body with finger joints that move; skin, shapes and the 22 body joints stay as they are.

    See ``with_finger_joints``.

    Raises:
        BodyInvalid: the body has no fingers and is not the one that ships.
    """
    hands = _hands_file() if needs_hands_file(body.layout) else None
    skinning = with_finger_joints(
        body.layout, Skinning(body.weights, body.J_regressor, body.posedirs), body.id, hands
    )  # fmt: skip
    parents = body.layout.parents if body.layout.joints == SMPL_H.joints else SMPL_HANDS.parents
    return replace(
        body, weights=skinning.weights, J_regressor=skinning.J_regressor, posedirs=skinning.posedirs,
        layout=replace(SMPL_HANDS, parents=parents), hands_mean=None,
    )  # fmt: skip


def flat_hands(body: Body) -> Float[np.ndarray, "30 3 3"]:
    """Return (30, 3, 3) rotations of the finger joints from the body's rest to a flat hand, which AMASS counts from.

    Args:
        body: with or without finger joints; SMPL-H's and SMPL-X's hands are flat at rest.
    """
    own = body.id == str(_hands_file()["body_id"])
    return _hands_file()["flat"].astype(np.float64) if own else np.tile(np.eye(3), (_NUM_FINGERS, 1, 1))


def with_hand_size(body: Body, size: float) -> Body:
    """Return the body with larger or smaller hands: ``v + (size - 1) d``, see ``hand_size_directions``.

    Args:
        body: from ``with_fingers``.
        size: of the hands, relative to what the body's shape gives them.

    Raises:
        BodyInvalid: the size is not positive.
    """
    if not size > 0.0:
        raise BodyInvalid(f"The relative size of hands is {size}; a positive number is expected.", where=body.id)
    directions = hand_size_directions(body.v_template, body.weights, body.joints_template)
    return replace(body, v_template=body.v_template + (size - 1.0) * directions)


def hand_size_directions(
    vertices: Float[np.ndarray, "vertices 3"], weights: Float[np.ndarray, "vertices 52"],
    joints: Float[np.ndarray, "52 3"],
) -> Float[np.ndarray, "vertices 3"]:  # fmt: skip
    """Return (V, 3) ``s (v - wrist)``, metres per unit of relative hand size; s rises with what a hand carries.

    Args:
        vertices: (V, 3) rest vertices, metres.
        weights: (V, 52).
        joints: (52, 3) rest joints, metres.
    """
    directions = np.zeros_like(vertices)
    for side in ("left", "right"):
        wrist = SMPL_HANDS.joints.index(f"{side}_wrist")
        share = weights[:, [wrist, *SMPL_HANDS.group(f"{side}_hand")]].sum(axis=1)
        # Smooth at both ends, so that the forearm runs into a larger hand without a step.
        directions += (share * share * (3.0 - 2.0 * share))[:, None] * (vertices - joints[wrist])
    return directions


@lru_cache(maxsize=1)
def _hands_file() -> dict[str, np.ndarray]:
    """Return what is kept of the hands of the body that ships."""
    return read_npz(DEFAULT_BODY.with_name(HANDS_FILE), HANDS_KEYS.__contains__)
