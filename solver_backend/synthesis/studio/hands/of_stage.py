"""Hands of a shot: fingers that move, what cameras see of them, and what a detector makes of that."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver_backend.body.hands import with_fingers
from solver_backend.body.mesh import pose_mesh
from solver_backend.cameras.projection import project
from solver_backend.geometry.rotations import log_so3
from solver_backend.synthesis.simulation.cast import Person
from solver_backend.synthesis.studio.hands.hand_detector import HandFaults, detect_hands
from solver_backend.synthesis.studio.hands.hand_occlusion import hidden_by_hands
from solver_backend.synthesis.studio.hands.hand_sight import hidden_points
from solver_backend.synthesis.studio.hands.moving_hands import MovingHands
from solver_backend.types import UNSEEN_POINT, Cameras, Capture


def skin_with_hands(person: Person, hands: MovingHands, frames: np.ndarray) -> np.ndarray:
    """Return the (n, V, 3) vertices of a person whose fingers move, in these frames."""
    body = with_fingers(person.body)
    local = np.concatenate([person.local[frames], hands.rotations()[frames]], axis=1)
    return pose_mesh(body, person.betas, person.orient[frames], local, person.transl[frames])


def finger_turns(hands: MovingHands) -> np.ndarray:
    """Return (F, 30, 3) axis-angles of the finger joints, in SMPL-H's order."""
    return log_so3(hands.rotations())


def hidden_of(person: Person, cameras: Cameras, hands: MovingHands) -> np.ndarray:
    """Return (C, F, 2, 21) whether the body, or a finger or palm of either hand, stands before a point."""
    return hidden_points(person, cameras, hands.points) | hidden_by_hands(cameras.centres, hands.points)


def with_true_hands(capture: Capture, cameras: Cameras, hands: MovingHands, hidden: np.ndarray) -> Capture:
    """Return a clean capture with every point of the hands in the picture, hidden or not, and the truth of them.

    Args:
        capture: of the body.
        cameras: of the shot.
        hands: of the person.
        hidden: (C, F, 2, 21), see ``hidden_of``.
    """
    assert capture.keypoints is not None
    px = project(cameras, hands.points)
    with np.errstate(invalid="ignore"):
        inside = ((px >= -0.5) & (px < cameras.image_size[:, None, None, None] - 0.5)).all(-1)
    found = np.concatenate([px, np.ones((*px.shape[:-1], 1))], axis=-1)
    found[~inside] = UNSEEN_POINT
    truth = {"hand_points": hands.points, "hand_angles": hands.angles, "hand_hidden": hidden}
    return replace(capture, keypoints=replace(capture.keypoints, hands=found), truth=capture.truth | truth)


def with_found_hands(
    capture: Capture, cameras: Cameras, hands: MovingHands, hidden: np.ndarray, fps: float, rng: np.random.Generator
) -> Capture:
    """Return a perturbed capture with the hands that a detector finds.

    Args:
        capture: of the body.
        cameras: that filmed, as they are.
        hands: of the person.
        hidden: (C, F, 2, 21), see ``hidden_of``.
        fps: frames per second.
        rng: seeded source of randomness.
    """
    assert capture.keypoints is not None
    found = detect_hands(cameras, hands.points, hidden, fps, HandFaults(), rng)
    return replace(capture, keypoints=replace(capture.keypoints, hands=found))
