"""Define joint sets: the anatomical point for each column of a detector's output."""

from __future__ import annotations

import re
from enum import StrEnum
from typing import Self

from .body_layout import SMPL

SMPL_JOINTS: tuple[str, ...] = SMPL.joints  # SMPL's joints in SMPL's order.
SMPL_PARENTS: tuple[int, ...] = SMPL.parents  # Index of each SMPL joint's parent, -1 for the root.
NUM_JOINTS = SMPL.num_joints  # Number of SMPL joints.
NUM_BODY_JOINTS = SMPL.num_solved  # Number of joints after the root that the solver rotates, without hands.
NUM_BETAS = 10  # Number of shape coefficients.
_PARTS = {
    "arm": "shoulder elbow wrist",
    "leg": "hip knee ankle",
    "foot": "big_toe small_toe heel",
    "limbs": "shoulder elbow wrist hip knee ankle",
    "mediapipe": "shoulder elbow wrist pinky index thumb hip knee ankle heel big_toe",
}
"""Keypoints on one side. ``up-`` reverses their order."""
_SIDE = re.compile(r"^(left|right)(?=_)|(?<=^mouth_)(left|right)$")


def _columns(text: str) -> tuple[str, ...]:
    """Expand a column list to one keypoint per column. ``both:arm`` alternates between left and right."""
    found: list[str] = []
    for word in text.split():
        side, _, part = word.rpartition(":")
        names = _PARTS.get(part.removeprefix("up-"), part).split()[:: -1 if part.startswith("up-") else 1]
        sides = {"": [""], "both": ["left_", "right_"]}.get(side, [f"{side}_"])
        found += [f"{one}{name}" for name in names for one in sides]
    return tuple(found)


_COCO = "nose both:eye both:ear both:limbs"
_FEET = "left:foot right:foot"
_ARMS, _LEGS, _LEGS_UP = "right:arm left:arm", "right:leg left:leg", "right:up-leg left:leg"
_EYES = "right_eye left_eye right_ear left_ear"


class JointSet(StrEnum):
    """A set of keypoints that a detector finds. The value is the set's name in files."""

    _value_: str
    keypoints: tuple[str, ...]  # Anatomical name of each used column, starting with the first column.
    num_written: tuple[int, ...]
    """Possible numbers of columns in detector output. Additional columns are hands and face (also for BODY_25) and
    MPII's chest. Whole-body COCO detectors may write only the first 23 columns: body and feet."""

    def __new__(cls, name: str, keypoints: str = "", *written: int) -> Self:
        """Create a joint set from its name, its column list and the possible numbers of columns in files."""
        member = str.__new__(cls, name)
        member._value_ = name
        member.keypoints = _columns(keypoints)
        member.num_written = written or (len(member.keypoints),)
        return member

    BODY_25 = "BODY_25", f"nose neck {_ARMS} mid_hip {_LEGS} {_EYES} {_FEET}", 25, 135
    BODY_25B = "BODY_25B", f"{_COCO} upper_neck head_top {_FEET}"
    COCO_17 = "COCO_17", _COCO
    COCO_WHOLEBODY_133 = "COCO_WHOLEBODY_133", f"{_COCO} {_FEET}", 133, 23
    HALPE_26 = "HALPE_26", f"{_COCO} head_top neck mid_hip both:foot"
    HALPE_136 = "HALPE_136", f"{_COCO} head_top neck mid_hip both:foot", 136
    MEDIAPIPE_33 = (
        "MEDIAPIPE_33",
        "nose left_eye_inner left_eye left_eye_outer right_eye_inner right_eye right_eye_outer both:ear mouth_left "
        "mouth_right both:mediapipe",
    )
    COCO_18 = "COCO_18", f"nose neck {_ARMS} {_LEGS} {_EYES}"
    MPII_15 = "MPII_15", f"head_top neck {_ARMS} {_LEGS}", 15
    MPII_16 = "MPII_16", f"{_LEGS_UP} mid_hip thorax upper_neck head_top right:up-arm left:arm"
    LSP_14 = "LSP_14", f"{_LEGS_UP} right:up-arm left:arm neck head_top"
    CROWDPOSE_14 = "CROWDPOSE_14", "both:limbs head_top neck"
    AIC_14 = "AIC_14", f"{_ARMS} {_LEGS} head_top neck"
    PANOPTIC_19 = (
        "PANOPTIC_19",
        "neck nose mid_hip left:arm left:leg right:arm right:leg left_eye left_ear right_eye right_ear",
    )
    BODY_135 = "BODY_135", f"{_COCO} upper_neck head_top {_FEET}", 135
    H36M_17 = "H36M_17", "mid_hip right:leg left:leg spine thorax nose head_top left:arm right:arm"
    SMPL_24 = "SMPL_24", " ".join(SMPL_JOINTS)

    @property
    def num_keypoints(self) -> int:
        """Number of keypoints in use. Additional columns of a file are ignored."""
        return len(self.keypoints)

    def mirrored(self, count: int = 0) -> tuple[int, ...]:
        """Return the column of each keypoint's counterpart on the other side.

        Keypoints without a counterpart map to themselves, as do additional columns up to ``count``.
        """
        other = {"left": "right", "right": "left"}
        swapped = [_SIDE.sub(lambda found: other[found[0]], name) for name in self.keypoints]
        return (*map(self.keypoints.index, swapped), *range(len(swapped), count))

    @classmethod
    def fitting(cls, num_keypoints: int) -> tuple[JointSet, ...]:
        """Return the joint sets that can have this number of columns in detector output."""
        return tuple(s for s in cls if num_keypoints in s.num_written)


FINGERS: tuple[str, ...] = ("thumb", "index", "middle", "ring", "pinky")  # In the order of the hand points.
HAND_POINTS: tuple[str, ...] = (
    *("wrist", "thumb_cmc", "thumb_mcp", "thumb_ip", "thumb_tip"),
    *(f"{finger}_{place}" for finger in FINGERS[1:] for place in ("mcp", "pip", "dip", "tip")),
)
"""The 21 points defined by OpenPose (Simon et al. 2017), also used by MediaPipe, COCO-WholeBody and Halpe."""
NUM_HAND_POINTS = len(HAND_POINTS)  # Number of points per hand.
SIDES: tuple[str, str] = ("left", "right")  # In the order of the hands.
HAND_COLUMNS = {(JointSet.COCO_WHOLEBODY_133, 133): (91, 112), (JointSet.HALPE_136, 136): (94, 115)}
"""First column of the left and right hand, by joint set and number of keypoints in the file. Hands follow the body, the
feet and the 68 face points (Jin et al. 2020; Fang et al. 2022)."""
