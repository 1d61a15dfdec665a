"""Plain data that moves through the pipeline; imports nothing but the exchange library."""

from solver_backend.exchange.joint_sets import (
    NUM_BETAS,
    NUM_BODY_JOINTS,
    NUM_JOINTS,
    SMPL_JOINTS,
    SMPL_PARENTS,
    JointSet,
)
from solver_backend.exchange.motion_file import FLAG_UNSEEN, FLAG_UNSURE
from solver_backend.types.cameras import Cameras
from solver_backend.types.capture import Capture, Keypoints2D, MarkerCloud
from solver_backend.types.fault import Fault, FaultKind, Remedy
from solver_backend.types.limbs import FEET, LIMBS
from solver_backend.types.motion import Motion

__all__ = [
    "FEET", "FLAG_UNSEEN", "FLAG_UNSURE", "LIMBS",
    "NUM_BETAS", "NUM_BODY_JOINTS", "NUM_JOINTS", "SMPL_JOINTS", "SMPL_PARENTS",
    "Cameras", "Capture", "Fault", "FaultKind", "JointSet", "Keypoints2D", "MarkerCloud", "Motion", "Remedy",
]  # fmt: skip
