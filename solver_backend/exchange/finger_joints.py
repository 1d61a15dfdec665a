"""Add finger joints to a body, from our hands file or from SMPL-H or SMPL-X."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from .body_layout import SMPL, SMPL_H, SMPL_HANDS, BodyLayout
from .errors import BodyInvalid

HANDS_FILE = "hands_neutral.npz"
"""File next to the shipped body that contains the hands' finger joints, weights and correctives."""
HANDS_KEYS = ("body_id", "vertices", "weights", "J_regressor", "posedirs", "flat")  # Arrays read from that file.
FIRST_FINGER = 1 + SMPL.num_solved  # Index of the first finger joint in ``SMPL_HANDS``.


@dataclass(frozen=True, eq=False)
class Skinning:
    """Skinning weights for V vertices and J joints."""

    weights: np.ndarray  # (V, J) weights. Rows sum to 1.
    J_regressor: np.ndarray  # (J, V) joint regressor. Rows sum to 1.
    posedirs: np.ndarray | None  # (V, 3, 9 (J - 1)) metres per unit of pose feature, or None without correctives.


def needs_hands_file(layout: BodyLayout) -> bool:
    """Return whether a body with this layout takes its finger joints from ``HANDS_FILE``."""
    return not set(SMPL_H.joints) <= set(layout.joints)


def with_finger_joints(
    layout: BodyLayout, skinning: Skinning, body_id: str, hands: Mapping[str, np.ndarray] | None
) -> Skinning:
    """Convert a body's skinning to the joints in ``SMPL_HANDS``. The skin at rest does not change.

    The head takes over the weights of SMPL-X's jaw and eyes.

    Args:
        hands: arrays from ``HANDS_FILE``, or None if the body has fingers (see ``needs_hands_file``).

    Raises:
        BodyInvalid: the body has no fingers, and the hands file is for another body.
    """
    if layout.joints == SMPL_HANDS.joints:
        return skinning
    if not needs_hands_file(layout):
        return _without_face(layout, skinning)
    if layout.joints != SMPL.joints or hands is None or str(hands["body_id"]) != body_id:
        what = f"The body {body_id} has no finger joints."
        raise BodyInvalid(what, where=body_id, hint="Use the included body, or an SMPL-H or SMPL-X file.")
    count, chosen = len(skinning.weights), hands["vertices"].astype(np.int64)
    if len(chosen) and chosen.max() >= count:
        raise BodyInvalid("The hands file is for another body, with other vertices.", where=body_id)
    kept, features = slice(0, FIRST_FINGER), 9 * SMPL.num_solved
    weights = np.zeros((count, SMPL_HANDS.num_joints))
    weights[:, kept] = skinning.weights[:, kept]
    weights[chosen] = hands["weights"]
    regressor = np.zeros((SMPL_HANDS.num_joints, count))
    regressor[kept] = skinning.J_regressor[kept]
    regressor[FIRST_FINGER:, chosen] = hands["J_regressor"]
    posedirs = np.zeros((count, 3, 9 * (SMPL_HANDS.num_joints - 1)))
    if skinning.posedirs is not None:
        posedirs[..., :features] = skinning.posedirs[..., :features]
    posedirs[chosen, :, features:] = hands["posedirs"]
    return Skinning(weights / weights.sum(axis=1, keepdims=True), regressor, posedirs)


def from_flat(rotations: np.ndarray, flat: np.ndarray) -> np.ndarray:
    """Convert finger rotations from a flat hand to the rest pose: ``R_j = F_pᵀ R'_j F_j``.

    F_j rotates bone j from rest to the flat hand, and p is its parent. A bone that points along d at rest points along
    ``F d`` in the flat hand, so its rotation from rest is ``G' F``. The wrist has no F.

    Args:
        rotations: (..., 30, 3, 3) R', each joint relative to its parent.
        flat: (30, 3, 3) F from ``HANDS_FILE``.
    """
    return np.swapaxes(_of_parents(flat), -1, -2) @ rotations @ flat


def to_flat(rotations: np.ndarray, flat: np.ndarray) -> np.ndarray:
    """Convert finger rotations from the rest pose to a flat hand. This inverts ``from_flat``."""
    return _of_parents(flat) @ rotations @ np.swapaxes(flat, -1, -2)


def _of_parents(flat: np.ndarray) -> np.ndarray:
    above = np.tile(np.eye(3), (len(flat), 1, 1))
    beyond = np.arange(len(flat)) % 3 > 0
    above[beyond] = flat[np.flatnonzero(beyond) - 1]
    return above


def _without_face(layout: BodyLayout, skinning: Skinning) -> Skinning:
    names = layout.joints
    kept = [names.index(name) for name in SMPL_HANDS.joints]
    weights, posedirs = skinning.weights.copy(), skinning.posedirs
    weights[:, names.index("head")] += weights[:, list(layout.group("face"))].sum(axis=1)
    if posedirs is not None:
        blocks = posedirs.reshape(*posedirs.shape[:2], -1, 9)[:, :, [j - 1 for j in kept[1:]]]
        posedirs = blocks.reshape(*posedirs.shape[:2], -1)
    return Skinning(weights[:, kept], skinning.J_regressor[kept], posedirs)
