"""Which poses are of the thesis' Tail set: crossed legs, crossed arms, kicks, crouching; and which are on the floor."""

from __future__ import annotations

import numpy as np

from solver_backend.exchange.body_layout import SMPL
from solver_backend.exchange.joint_sets import NUM_JOINTS
from training.data.points import rotation_points

GROUPS: tuple[str, ...] = ("crossed legs", "crossed arms", "kicks", "crouching")
CROSSED_M = 0.06
"""Ankles, or wrists, are this far on the wrong side of each other, measured along the hips, or the shoulders."""
KICK_M = -0.25
"""An ankle of a kick is at least so high against the pelvis."""
CROUCH_M = 0.5
"""Pelvis above the lower ankle in a crouch, on a skeleton whose legs are 0.78 m from hip to ankle."""
LEANING_DEG = 55.0
"""Trunks that lean further are on the floor, or in the air."""
_PAIR = {part: SMPL.both(part) for part in ("hip", "ankle", "shoulder", "wrist")}
"""The left and the right joint of each part."""
(_CHEST,) = SMPL.numbers("spine3")


def groups_of(rotations: np.ndarray) -> np.ndarray:
    """Return (N, 4) bool, by ``GROUPS``, of (N, 22, 3, 3) poses, the pelvis first, Y up."""
    joints = _joints(rotations)
    upright = _lean_deg(rotations) < LEANING_DEG
    ankles = joints[:, _PAIR["ankle"], 1]
    height = joints[:, 0, 1] - ankles.min(1)
    legs = _order(joints, "hip", "ankle") < -CROSSED_M
    wrists = joints[:, _PAIR["wrist"]]
    chest = joints[:, _CHEST]
    near = (np.linalg.norm(wrists - chest[:, None], axis=-1) < 0.42).all(1)
    arms = (_order(joints, "shoulder", "wrist") < -CROSSED_M) & near
    foot = ankles.max(1) - joints[:, 0, 1]
    kick = (foot > KICK_M) & (height > CROUCH_M)
    crouch = height < CROUCH_M
    return np.stack([legs, arms, kick, crouch], axis=1) & upright[:, None]


def on_the_floor(rotations: np.ndarray) -> np.ndarray:
    """Return (N,) whether the trunk lies, or kneels so far forward that the hands reach the floor."""
    joints = _joints(rotations)
    return (_lean_deg(rotations) >= LEANING_DEG) | (np.ptp(joints[:, :, 1], axis=1) < 0.85)


def _joints(rotations: np.ndarray) -> np.ndarray:
    """Return (N, 24, 3) joints about the pelvis, in the world's axes."""
    joints = rotation_points(rotations[:, 1:].astype(np.float32))[:, :NUM_JOINTS]
    return np.einsum("nij,nkj->nki", rotations[:, 0].astype(np.float32), joints)


def _lean_deg(rotations: np.ndarray) -> np.ndarray:
    return np.degrees(np.arccos(np.clip(rotations[:, 0, 1, 1], -1.0, 1.0)))


def _order(joints: np.ndarray, base: str, end: str) -> np.ndarray:
    """Return how far the left end is to the left of the right one, along the line of the bases, metres."""
    (left, right), (left_end, right_end) = _PAIR[base], _PAIR[end]
    across = joints[:, left] - joints[:, right]
    across /= np.linalg.norm(across, axis=-1, keepdims=True)
    return ((joints[:, left_end] - joints[:, right_end]) * across).sum(-1)
