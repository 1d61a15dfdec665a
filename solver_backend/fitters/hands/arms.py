"""Arms that follow their hands: joints turn as little as it takes for the wrist to be where its hand is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.kinematics import forward_kinematics
from solver_backend.exchange.hand_points import SIDES
from solver_backend.fitters.model.posed_frames import PosedFrames
from solver_backend.geometry.arrays import to_numpy
from solver_backend.geometry.quaternions import quat_from_matrix
from solver_backend.geometry.rotations import exp_so3, skew
from solver_backend.types.shapes import Float

STEPS = 6
"""Gauss-Newton steps; shifts are a few centimetres at most, and three do where the arm is bent."""
COLLAR = 0.1
"""How readily the collar turns, by shoulder and elbow: a stretched arm reaches further by it alone. Chosen by hand; in
Pose2Sim's balancing trial the left wrist, 10 mm out of reach (52 in one frame of ten), is met with 11 degrees."""
PRONATION = 0.5
"""Share of a hand's twist about the forearm that the elbow takes, as in the recordings that the pose prior knows."""
LOADING_M2 = 1e-4
"""Of the normal matrix: beyond what arm and collar reach no turn helps."""


def follow_hand(
    body: Body, betas: np.ndarray, frames: PosedFrames, side: int,
    turn: Float[np.ndarray, "frames 3"], shift: Float[np.ndarray, "frames 3"],
) -> PosedFrames:  # fmt: skip
    """Return the poses with a wrist turned and moved; whatever does not hang on that arm stays bit for bit.

    ``ω = W Jᵀ (J W Jᵀ + λ)⁻¹ (p + δ - p(ω))``, the least turns of collar, shoulder and elbow (Whitney 1969, damped).

    Args:
        body: the body model.
        betas: (10,) shape.
        frames: F poses.
        side: 0 left, 1 right.
        turn: (F, 3) rotation vectors of the wrist in the world.
        shift: (F, 3) metres.
    """
    names = body.layout.joints
    chain = [names.index(f"{SIDES[side]}_{part}") for part in ("collar", "shoulder", "elbow")]
    elbow, wrist, ease = chain[-1], names.index(f"{SIDES[side]}_wrist"), np.repeat([COLLAR, 1.0, 1.0], 3)
    local = to_numpy(frames.local).copy()
    root, transl = to_numpy(frames.root), to_numpy(frames.transl)
    posed = forward_kinematics(body, betas, root, local, transl)
    wanted, hand = posed.joints[:, wrist] + shift, exp_so3(turn) @ posed.G[:, wrist]
    moved = np.linalg.norm(shift, axis=1) > 0
    for _ in range(STEPS):
        G, joints = posed.G, posed.joints
        J = np.concatenate([-skew(joints[:, wrist] - joints[:, j]) for j in chain], axis=2)
        eased_T = ease[:, None] * np.swapaxes(J, 1, 2)
        left = np.where(moved[:, None], wanted - joints[:, wrist], 0.0)
        step = eased_T @ np.linalg.solve(J @ eased_T + LOADING_M2 * np.eye(3), left[..., None])
        turn_so_far, parent = np.eye(3), G[:, body.parents[chain[0]]]
        for joint, own in zip(chain, np.moveaxis(exp_so3(step[..., 0].reshape(-1, 3, 3)), 1, 0), strict=True):
            turn_so_far = own @ turn_so_far
            here = turn_so_far @ G[:, joint]
            local[:, joint - 1] = np.where(moved[:, None, None], _since(parent, here), local[:, joint - 1])
            parent = here
        posed = forward_kinematics(body, betas, root, local, transl)
    still = ~moved & (np.linalg.norm(turn, axis=1) == 0)
    turned = _since(posed.G[:, elbow], hand)
    rest = body.rest_joints(betas)
    twist = exp_so3(PRONATION * _twist(turned, rest[wrist] - rest[elbow]))
    for joint, R in ((elbow, local[:, elbow - 1] @ twist), (wrist, np.swapaxes(twist, 1, 2) @ turned)):
        local[:, joint - 1] = np.where(still[:, None, None], local[:, joint - 1], R)
    return replace(frames, local=local)


def _twist(R: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Return (F, 3) the rotation vectors about an axis nearest to rotations: ``2 atan2(q·a, w)`` of a quaternion."""
    axis = axis / np.linalg.norm(axis)
    q = quat_from_matrix(R)
    angle = 2.0 * np.arctan2(q[:, 1:] @ axis, q[:, 0])
    return ((angle + np.pi) % (2.0 * np.pi) - np.pi)[:, None] * axis


def _since(parent: np.ndarray, G: np.ndarray) -> np.ndarray:
    """Return the (F, 3, 3) rotations G in the frames of their parents."""
    return np.swapaxes(parent, 1, 2) @ G
