"""Bones painted by their joints' confidence."""

from __future__ import annotations

import bpy
import numpy as np
from numpy.typing import ArrayLike

from ..animation.curves import current_action
from ..animation.lanes import confidence_at, resting_bones

_BAD, _MIDDLE, _GOOD = np.array([[0.86, 0.09, 0.07], [0.95, 0.72, 0.10], [0.16, 0.70, 0.30]])
RESTING = np.array([0.42, 0.47, 0.56])
"""Colour of what nothing measured: neither good nor bad."""
_ACTIVE_BLEND, _SELECT_BLEND = 0.65, 0.35
_VISIBLE = 0.02
"""Least change of a colour that is shown."""


def colours(confidence: ArrayLike) -> np.ndarray:
    """Return (..., 3) display colours: red at 0.3 and below, amber at 0.6, green from 0.9."""
    c = np.clip((np.asarray(confidence, np.float64)[..., None] - 0.3) / 0.6, 0.0, 1.0)
    low = _BAD + (_MIDDLE - _BAD) * np.minimum(1.0, 2 * c)
    return np.where(c < 0.5, low, _MIDDLE + (_GOOD - _MIDDLE) * (2 * c - 1))


def paint_bones(armature: bpy.types.Object, frame: float, *, shown: bool) -> None:
    """Paint the bones of a body by their confidence on a scene frame, those at rest grey, or take the paint off.

    Args:
        armature: of the body; without confidence nothing is done.
        frame: scene frame.
        shown: False takes the paint off.
    """
    action = current_action(armature)
    confidence = confidence_at(action, frame) if action is not None else {}
    if not shown:
        for name in confidence:
            armature.pose.bones[name].color.palette = "DEFAULT"
        return
    resting = resting_bones(armature, frame)
    for name, certain in zip(confidence, colours(list(confidence.values())), strict=True):
        colour = RESTING if name in resting else certain
        target = armature.pose.bones[name].color
        if target.palette != "CUSTOM":
            target.palette = "CUSTOM"
        elif max(abs(colour - target.custom.normal)) < _VISIBLE:
            continue  # every change has Blender redraw its editors
        target.custom.normal = colour
        target.custom.select = colour + _SELECT_BLEND * (1 - colour)
        target.custom.active = colour + _ACTIVE_BLEND * (1 - colour)
