"""The T-pose that rotations of the protocol are relative to, from a body's joints at rest."""

from __future__ import annotations

import numpy as np

from ..body_layout import BodyLayout
from ..so3 import quat_multiply

_ARM = ("shoulder", "elbow", "wrist")
_LEG = ("hip", "knee")
_FOOT = ("ankle", "foot")
_HANDS = ("left_hand", "right_hand")


def t_pose(layout: BodyLayout, rest_joints: np.ndarray) -> np.ndarray:
    """Return how each joint turns from a body's rest pose to the T-pose, all of it in the body's axes.

    Arms and fingers lie along ±X and legs along -Y, by the shortest turn of each bone; thumbs lie halfway between ±X
    and +Z (VRM 1.0, T-pose). Fingers turn on from what carries them, and their last bones with it. Feet turn about Y
    alone until they point along +Z, so that soles stay flat. Hips, spine, neck, head and shoulders do not turn, for how
    they are bent at rest belongs to the character.

    Args:
        layout: names and tree of the J joints.
        rest_joints: (J, 3) metres, Y up, facing +Z, left = +X.

    Returns:
        (J, 4) quaternions wxyz.
    """
    turns = np.tile([1.0, 0.0, 0.0, 0.0], (layout.num_joints, 1))
    for j, name in enumerate(layout.joints):
        side, _, part = name.partition("_")
        along = _bone(layout, rest_joints, j)
        if part in _ARM and along is not None:
            turns[j] = _shortest(along, np.array([1.0 if side == "left" else -1.0, 0.0, 0.0]))
        elif part in _LEG and along is not None:
            turns[j] = _shortest(along, np.array([0.0, -1.0, 0.0]))
        elif part == _FOOT[0] and along is not None:
            turns[j] = _shortest(along * (1.0, 0.0, 1.0), np.array([0.0, 0.0, 1.0]))
        elif part == _FOOT[1] or layout.groups[j] in _HANDS:
            turns[j] = turns[layout.parents[j]]
            if layout.groups[j] in _HANDS and along is not None:
                flat = np.array([1.0 if side == "left" else -1.0, 0.0, float(part.startswith("thumb"))])
                turns[j] = quat_multiply(_shortest(turned(turns[j], along), flat), turns[j])
    return turns


def _bone(layout: BodyLayout, rest_joints: np.ndarray, j: int) -> np.ndarray | None:
    """Return where a bone points: to its own limb's next joint, of a wrist to the middle finger or the knuckles."""
    children = layout.children[j]
    knuckles = [c for c in children if "middle" in layout.joints[c] or layout.joints[c].endswith("_hand")]
    end = layout.main_child.get(j, (knuckles or [None])[0])
    if end is None:
        return None
    along = rest_joints[end] - rest_joints[j]
    return along if np.linalg.norm(along) > 1e-6 else None


def _shortest(source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Return the shortest turn of one direction onto another: ``(1 + a·b, a × b)``, of length 1."""
    source, target = source / np.linalg.norm(source), target / np.linalg.norm(target)
    turn = np.concatenate([[1.0 + source @ target], np.cross(source, target)])
    length = np.linalg.norm(turn)
    # Opposite directions have no shortest turn; no body rests with an arm through its chest.
    return turn / length if length > 1e-6 else np.array([1.0, 0.0, 0.0, 0.0])


def unturned(quat: np.ndarray) -> np.ndarray:
    """Return the inverse of unit quaternions wxyz."""
    return quat * (1.0, -1.0, -1.0, -1.0)


def turned(quat: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Return (..., 3) vectors turned by (..., 4) unit quaternions wxyz."""
    pure = np.concatenate([np.zeros((*vectors.shape[:-1], 1)), vectors], axis=-1)
    return quat_multiply(quat_multiply(quat, pure), unturned(quat))[..., 1:]
