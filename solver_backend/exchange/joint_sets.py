"""Keypoint vocabularies: which anatomical point each column of a detector's output is."""

from __future__ import annotations

import re
from enum import StrEnum
from typing import Self

from .body_layout import SMPL

SMPL_JOINTS: tuple[str, ...] = SMPL.joints  # SMPL's joints in SMPL's order.
SMPL_PARENTS: tuple[int, ...] = SMPL.parents  # Parent of each SMPL joint; -1 at the root.
NUM_JOINTS = SMPL.num_joints  # Joints of SMPL.
NUM_BODY_JOINTS = SMPL.num_solved
"""Joints after the root that solves turn and the priors that ship with the code model: no hands."""
NUM_BETAS = 10  # Numbers of a shape.

_COCO = (
    "nose", "left_eye", "right_eye", "left_ear", "right_ear", "left_shoulder", "right_shoulder",
    "left_elbow", "right_elbow", "left_wrist", "right_wrist", "left_hip", "right_hip", "left_knee",
    "right_knee", "left_ankle", "right_ankle",
)  # fmt: skip
_BODY_25B = (
    *_COCO, "upper_neck", "head_top", "left_big_toe", "left_small_toe", "left_heel", "right_big_toe", "right_small_toe",
    "right_heel",
)  # fmt: skip
_HALPE_BODY = (
    *_COCO, "head_top", "neck", "mid_hip", "left_big_toe", "right_big_toe", "left_small_toe", "right_small_toe",
    "left_heel", "right_heel",
)  # fmt: skip


_SIDE = re.compile(r"^(left|right)(?=_)|(?<=^mouth_)(left|right)$")


class JointSet(StrEnum):
    """A detector's vocabulary; its value is the name written to files."""

    _value_: str
    keypoints: tuple[str, ...]  # Anatomical name of each column that is used: the first ones, see ``num_written``.
    num_written: tuple[int, ...]
    """Numbers of columns that detectors write. More than are used are hands and face, also behind BODY_25, and MPII's
    chest; of COCO's whole body detectors also write the first 23 alone: body and feet."""

    def __new__(cls, name: str, keypoints: tuple[str, ...] = (), written: tuple[int, ...] = ()) -> Self:
        """Make a member that is its name and has its columns."""
        member = str.__new__(cls, name)
        member._value_ = name
        member.keypoints = keypoints
        member.num_written = written or (len(keypoints),)
        return member

    # fmt: off
    BODY_25 = "BODY_25", (
        "nose", "neck", "right_shoulder", "right_elbow", "right_wrist", "left_shoulder", "left_elbow",
        "left_wrist", "mid_hip", "right_hip", "right_knee", "right_ankle", "left_hip", "left_knee",
        "left_ankle", "right_eye", "left_eye", "right_ear", "left_ear", "left_big_toe",
        "left_small_toe", "left_heel", "right_big_toe", "right_small_toe", "right_heel",
    ), (25, 135)
    BODY_25B = "BODY_25B", _BODY_25B
    COCO_17 = "COCO_17", _COCO
    COCO_WHOLEBODY_133 = "COCO_WHOLEBODY_133", (
        *_COCO, "left_big_toe", "left_small_toe", "left_heel", "right_big_toe", "right_small_toe",
        "right_heel",
    ), (133, 23)
    HALPE_26 = "HALPE_26", _HALPE_BODY
    HALPE_136 = "HALPE_136", _HALPE_BODY, (136,)
    MEDIAPIPE_33 = "MEDIAPIPE_33", (
        "nose", "left_eye_inner", "left_eye", "left_eye_outer", "right_eye_inner", "right_eye",
        "right_eye_outer", "left_ear", "right_ear", "mouth_left", "mouth_right", "left_shoulder",
        "right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist", "left_pinky",
        "right_pinky", "left_index", "right_index", "left_thumb", "right_thumb", "left_hip",
        "right_hip", "left_knee", "right_knee", "left_ankle", "right_ankle", "left_heel",
        "right_heel", "left_big_toe", "right_big_toe",
    )
    COCO_18 = "COCO_18", (
        "nose", "neck", "right_shoulder", "right_elbow", "right_wrist", "left_shoulder", "left_elbow", "left_wrist",
        "right_hip", "right_knee", "right_ankle", "left_hip", "left_knee", "left_ankle", "right_eye", "left_eye",
        "right_ear", "left_ear",
    )
    MPII_15 = "MPII_15", (
        "head_top", "neck", "right_shoulder", "right_elbow", "right_wrist", "left_shoulder", "left_elbow",
        "left_wrist", "right_hip", "right_knee", "right_ankle", "left_hip", "left_knee", "left_ankle",
    ), (15,)
    MPII_16 = "MPII_16", (
        "right_ankle", "right_knee", "right_hip", "left_hip", "left_knee", "left_ankle", "mid_hip", "thorax",
        "upper_neck", "head_top", "right_wrist", "right_elbow", "right_shoulder", "left_shoulder", "left_elbow",
        "left_wrist",
    )
    LSP_14 = "LSP_14", (
        "right_ankle", "right_knee", "right_hip", "left_hip", "left_knee", "left_ankle", "right_wrist", "right_elbow",
        "right_shoulder", "left_shoulder", "left_elbow", "left_wrist", "neck", "head_top",
    )
    CROWDPOSE_14 = "CROWDPOSE_14", (
        "left_shoulder", "right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist", "left_hip",
        "right_hip", "left_knee", "right_knee", "left_ankle", "right_ankle", "head_top", "neck",
    )
    AIC_14 = "AIC_14", (
        "right_shoulder", "right_elbow", "right_wrist", "left_shoulder", "left_elbow", "left_wrist", "right_hip",
        "right_knee", "right_ankle", "left_hip", "left_knee", "left_ankle", "head_top", "neck",
    )
    PANOPTIC_19 = "PANOPTIC_19", (
        "neck", "nose", "mid_hip", "left_shoulder", "left_elbow", "left_wrist", "left_hip", "left_knee", "left_ankle",
        "right_shoulder", "right_elbow", "right_wrist", "right_hip", "right_knee", "right_ankle", "left_eye",
        "left_ear", "right_eye", "right_ear",
    )
    BODY_135 = "BODY_135", _BODY_25B, (135,)
    H36M_17 = "H36M_17", (
        "mid_hip", "right_hip", "right_knee", "right_ankle", "left_hip", "left_knee", "left_ankle",
        "spine", "thorax", "nose", "head_top", "left_shoulder", "left_elbow", "left_wrist",
        "right_shoulder", "right_elbow", "right_wrist",
    )
    SMPL_24 = "SMPL_24", SMPL_JOINTS
    # fmt: on

    @property
    def num_keypoints(self) -> int:
        """Number of columns we use."""
        return len(self.keypoints)

    def mirrored(self, count: int = 0) -> tuple[int, ...]:
        """Return for each column the column of the same point on the other side; columns behind the set's stay."""
        other = {"left": "right", "right": "left"}
        swapped = [_SIDE.sub(lambda found: other[found[0]], name) for name in self.keypoints]
        return (*map(self.keypoints.index, swapped), *range(len(swapped), count))

    @classmethod
    def fitting(cls, num_keypoints: int) -> tuple[JointSet, ...]:
        """Return the sets whose detectors write this many keypoints."""
        return tuple(s for s in cls if num_keypoints in s.num_written)
