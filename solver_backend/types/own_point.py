"""A keypoint of a user's own that no joint set names: a point that a bone carries."""

from __future__ import annotations

from dataclasses import dataclass

from solver_backend.exchange.body_layout import SMPL
from solver_backend.exchange.rigs.roles import JOINT_OF

BONES = {role: SMPL.joints[joint] for role, joint in JOINT_OF.items()} | {
    name: name for name in ("spine1", "spine2", "spine3", "neck")
}
"""The joint that turns each bone, by what people call the bone: ``left_forearm`` turns at ``left_elbow``."""


@dataclass(frozen=True)
class OwnPoint:
    """A point at an unknown, constant place on a bone."""

    name: str
    """What the user calls it."""
    bone: str
    """Of ``BONES``."""
