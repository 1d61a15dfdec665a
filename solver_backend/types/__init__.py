"""Plain data that moves through the pipeline; imports nothing but the exchange library."""

from solver_backend.exchange.joint_sets import (
    NUM_BETAS,
    NUM_BODY_JOINTS,
    NUM_JOINTS,
    SMPL_JOINTS,
    SMPL_PARENTS,
    JointSet,
)
from solver_backend.exchange.motion_file import (
    FLAG_RESTING,
    FLAG_UNSEEN,
    FLAG_UNSURE,
    MARKER_FILLED,
    MARKER_GHOST,
    MARKER_SEEN,
    MARKER_SWAPPED,
)
from solver_backend.exchange.skeleton_file import SkeletonMotion
from solver_backend.types.cameras import Cameras
from solver_backend.types.capture import (
    BONES,
    FEET,
    LIMBS,
    UNSEEN_POINT,
    Capture,
    Keypoints2D,
    OwnPoint,
    PersonInViews,
    stacked_hands,
)
from solver_backend.types.marker_cloud import MarkerCloud, MarkerSubject
from solver_backend.types.motion import Motion

__all__ = [
    "BONES",
    "FEET",
    "FLAG_RESTING",
    "FLAG_UNSEEN",
    "FLAG_UNSURE",
    "LIMBS",
    "MARKER_FILLED",
    "MARKER_GHOST",
    "MARKER_SEEN",
    "MARKER_SWAPPED",
    "NUM_BETAS",
    "NUM_BODY_JOINTS",
    "NUM_JOINTS",
    "SMPL_JOINTS",
    "SMPL_PARENTS",
    "UNSEEN_POINT",
    "Cameras",
    "Capture",
    "JointSet",
    "Keypoints2D",
    "MarkerCloud",
    "MarkerSubject",
    "Motion",
    "OwnPoint",
    "PersonInViews",
    "SkeletonMotion",
    "stacked_hands",
]  # fmt: skip
