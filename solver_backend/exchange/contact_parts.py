"""List the body parts that can touch floors and objects."""

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
"""For each part, the joints that move its skin most. Blender represents the part by the first joint's bone. The knee
part includes the shank, the elbow part the forearm, and the seat the thighs."""
FEET = 2  # Number of feet, which come first among the parts.
MIRRORED = (1, 0, 3, 2, 5, 4, 7, 6, 8, 9, 10)  # Index of the corresponding part on the other side.


def part_of_joint(joint: str) -> str | None:
    """Return the contact part that moves with a joint, or None for joints such as fingers."""
    return next((part for part, joints in CONTACT_PARTS.items() if joint in joints), None)
