"""List the body parts that touch floors and objects."""

from __future__ import annotations

CONTACT_PARTS = {
    "left_foot": ("left_ankle", "left_foot"), "right_foot": ("right_ankle", "right_foot"),
    "left_knee": ("left_knee",), "right_knee": ("right_knee",),
    "left_elbow": ("left_elbow",), "right_elbow": ("right_elbow",),
    "left_hand": ("left_wrist", "left_hand"), "right_hand": ("right_wrist", "right_hand"),
    "seat": ("pelvis", "left_hip", "right_hip"),
    "back": ("spine1", "spine2", "spine3", "left_collar", "right_collar", "left_shoulder", "right_shoulder"),
    "head": ("neck", "head"),
}  # fmt: skip
"""Joints with the largest influence on each part's skin. The first joint's bone represents the part in Blender. The
knee part includes the shank, the elbow part the forearm, and the seat the thighs."""
FEET = 2  # Number of feet, which are the first parts.
MIRRORED = (1, 0, 3, 2, 5, 4, 7, 6, 8, 9, 10)  # Index of the part on the other side.


def part_of_joint(joint: str) -> str | None:
    """Return the part whose skin a joint moves, or None for joints such as fingers."""
    return next((part for part, joints in CONTACT_PARTS.items() if joint in joints), None)
