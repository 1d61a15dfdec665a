"""The hands of a body as skeletons of their own, and what their angles are in the body's rotations."""

from __future__ import annotations

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.finger_frames import finger_frames
from solver_backend.body.hand_skeleton import HandSkeleton
from solver_backend.exchange.body_layout import SMPL_FINGERS
from solver_backend.exchange.hand_points import FINGERS, SIDES
from solver_backend.types.shapes import Float

_FROM_POINTS = np.array([FINGERS.index(finger) for finger in SMPL_FINGERS])
"""Our finger in each place of SMPL-H's order."""
_FROM_SMPL = np.array([SMPL_FINGERS.index(finger) for finger in FINGERS])
"""SMPL-H's finger in each place of ours."""


def hand_of_body(body: Body, betas: Float[np.ndarray, " 10"], side: int) -> HandSkeleton:
    """Return the skeleton of a hand, from the wrist to the fingers' ends on the skin, in the body's rest frame.

    Args:
        body: whose fingers move, see ``with_fingers``.
        betas: (10,) its shape.
        side: 0 left, 1 right.
    """
    joints, layout = body.rest_joints(betas), body.layout
    ends = finger_frames(body).tip_vertices
    skin = body.v_template[ends] + body.shapedirs[ends] @ betas
    own = joints[list(layout.group(f"{SIDES[side]}_hand"))].reshape(5, 3, 3)[_FROM_SMPL]
    tips = skin.reshape(2, 5, 3)[side][_FROM_SMPL]
    chain = np.concatenate([own, tips[:, None]], axis=1)
    wrist = joints[layout.joints.index(f"{SIDES[side]}_wrist")]
    return HandSkeleton.of_points(np.concatenate([wrist[None], chain.reshape(-1, 3)]), side)


def in_order_of_points(values: np.ndarray) -> np.ndarray:
    """Return (F, 5, 3, ...) values by finger of ours from (F, 15, ...) of a hand's joints in SMPL-H's order."""
    return values.reshape(len(values), 5, 3, *values.shape[2:])[:, _FROM_SMPL]


def in_order_of_smpl(values: np.ndarray) -> np.ndarray:
    """Return (F, 15, ...) values of a hand's joints in SMPL-H's order from (F, 5, 3, ...) by finger of ours."""
    ordered = values[:, _FROM_POINTS]
    return ordered.reshape(len(values), 15, *values.shape[3:])
