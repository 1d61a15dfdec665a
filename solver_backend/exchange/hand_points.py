"""The points of a hand, as every detector numbers them, and where whole-body detectors write them."""

from __future__ import annotations

from .joint_sets import JointSet

FINGERS: tuple[str, ...] = ("thumb", "index", "middle", "ring", "pinky")  # In the order of the points.
HAND_POINTS: tuple[str, ...] = (
    "wrist",
    "thumb_cmc", "thumb_mcp", "thumb_ip", "thumb_tip",
    *(f"{finger}_{place}" for finger in FINGERS[1:] for place in ("mcp", "pip", "dip", "tip")),
)  # fmt: skip
"""The 21 points of OpenPose (Simon et al. 2017), which MediaPipe, COCO-WholeBody and Halpe share."""
NUM_HAND_POINTS = len(HAND_POINTS)  # Points of a hand.
SIDES: tuple[str, str] = ("left", "right")  # In the order of the hands.
HAND_COLUMNS: dict[tuple[JointSet, int], tuple[int, int]] = {
    (JointSet.COCO_WHOLEBODY_133, 133): (91, 112),
    (JointSet.HALPE_136, 136): (94, 115),
}
"""First columns of the left and the right hand, by joint set and number of keypoints written: behind body, feet and
the face's 68 points (Jin et al. 2020; Fang et al. 2022)."""
