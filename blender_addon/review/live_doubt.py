"""The doubt of a body that is live, on its bones: red where a joint could be elsewhere, or the whole pose is unsure."""

from __future__ import annotations

import bpy
import numpy as np

from .._exchange.motion_file import FLAG_UNSURE
from ..animation.confidence import joint_confidence
from ..conventions.skeleton import JOINTS
from .bone_colours import colour_bones


def show_doubt(armature: bpy.types.Object, sigma_m: np.ndarray, *, unsure: bool) -> None:
    """Paint the bones of a live body.

    Args:
        armature: of the body.
        sigma_m: (24,) standard deviation of each joint in metres, NaN where nothing is known of it.
        unsure: whether the pose as a whole is.
    """
    known = np.where(np.isfinite(sigma_m), sigma_m, np.inf)
    confidence = joint_confidence(known[None], np.array([FLAG_UNSURE if unsure else 0], np.uint8))[0]
    colour_bones(armature, {name: float(value) for name, value in zip(JOINTS, confidence, strict=True)})
