"""Parts of a body that hands can touch, and the skin of each."""

from __future__ import annotations

import numpy as np

from ..._exchange.rigs.roles import JOINT_OF, SIDES
from ...conventions.skeleton import SMPL, BodyLayout

_SPINE = (3, 6, 9)
"""SMPL's joints of the trunk over the pelvis."""


def parts_of_joints(layout: BodyLayout, joints: np.ndarray) -> np.ndarray:
    """Return the part of the body (V,) of each vertex of ours, "" for none.

    Args:
        layout: names of the joints.
        joints: (V,) joint that each vertex follows most.
    """
    columns, role_at = layout.standing_for(SMPL), {joint: role for role, joint in JOINT_OF.items()}
    parts = [""] * layout.num_joints
    for joint, column in enumerate(columns):
        parts[column] = "trunk" if joint in _SPINE else part_of_role(role_at.get(joint, ""))
    return np.array(parts)[joints]


def by_part(points: np.ndarray, parts: np.ndarray) -> dict[str, np.ndarray]:
    """Return points (V, 3) by the part (V,) of the body that they belong to; those of no part are left out."""
    return {str(part): points[parts == part] for part in np.unique(parts) if part}


def part_of_role(role: str) -> str:
    """Return the part of the body around a role's bone, "" for those that hands are not kept on."""
    side, _, part = role.partition("_")
    if role in ("pelvis", "head"):
        return "head" if role == "head" else "trunk"
    if role.startswith("spine_") or part == "clavicle":
        return "trunk"
    return role if side in SIDES and part in ("thigh", "shin", "upper_arm", "forearm") else ""
