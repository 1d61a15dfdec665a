"""Colours of bones, skins and frames by confidence."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import bpy
import numpy as np
from numpy.typing import ArrayLike

from ..animation.curves import current_action
from ..animation.lanes import confidence_at, read_lane, resting_bones
from ..body.armature import deform_bone
from .ranges import bad_ranges

_BAD, _MIDDLE, _GOOD = np.array([[0.86, 0.09, 0.07], [0.95, 0.72, 0.10], [0.16, 0.70, 0.30]])
RESTING = np.array([0.42, 0.47, 0.56])
"""Colour of joints without a measurement."""
_ACTIVE_BLEND, _SELECT_BLEND = 0.65, 0.35
_VISIBLE = 0.02
"""Smallest change of a colour to apply."""


def colours(confidence: ArrayLike) -> np.ndarray:
    """Return (..., 3) display colours: red at 0.3 and below, amber at 0.6, green from 0.9."""
    c = np.clip((np.asarray(confidence, np.float64)[..., None] - 0.3) / 0.6, 0.0, 1.0)
    low = _BAD + (_MIDDLE - _BAD) * np.minimum(1.0, 2 * c)
    return np.where(c < 0.5, low, _MIDDLE + (_GOOD - _MIDDLE) * (2 * c - 1))


def paint_bones(armature: bpy.types.Object, frame: float, *, shown: bool) -> None:
    """Colour the bones of a body by their confidence at a scene frame, grey at rest, or remove the colours."""
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


_INTERPOLATED = 1e-3  # Maximum confidence of an interpolated frame (``confidence.joint_confidence``).


def joint_weights(skin: bpy.types.Object, joints: tuple[str, ...]) -> np.ndarray:
    """Return (V, J) weights of joints normalised for each vertex, zeros for a vertex without weights.

    Args:
        skin: the skinned mesh.
        joints: names of the posed bones.
    """
    columns = {group.index: j for j, name in enumerate(joints) if (group := skin.vertex_groups.get(deform_bone(name)))}
    weights = np.zeros((len(skin.data.vertices), len(joints)))
    for vertex in skin.data.vertices:
        for item in vertex.groups:
            if item.group in columns:
                weights[vertex.index, columns[item.group]] = item.weight
    return weights / np.maximum(weights.sum(axis=1, keepdims=True), 1e-9)


def skin_colours(
    weights: np.ndarray, joints: tuple[str, ...], confidence: Mapping[str, float], resting: Collection[str] = ()
) -> np.ndarray:
    """Return (V, 3) display colours of a skin, grey at joints at rest, green at joints without a confidence.

    Args:
        weights: (V, J) from ``joint_weights``.
        confidence: by joint, in 0..1.
        resting: joints without a measurement.
    """
    rests = np.array([name in resting for name in joints])
    shown = weights @ np.where(rests, 1.0, [confidence.get(name, 1.0) for name in joints])
    share = weights[:, rests].sum(axis=1, keepdims=True)
    return (1.0 - share) * colours(shown) + share * RESTING


def doubtful_bands(take: bpy.types.Action, below: float) -> list[tuple[float, float, tuple[float, float, float]]]:
    """Return first frame, last frame and colour of each range below a confidence. Interpolated frames are red."""
    lane = read_lane(take)
    if lane is None:
        return []
    frames, confidence = lane
    found = []
    for bound in (below, min(below, _INTERPOLATED)):
        shade = colours(0.6 if bound == below else 0.0)
        found += [
            (float(frames[a]), float(frames[b]), tuple(shade)) for a, b in bad_ranges(confidence, bound, bridge=0)
        ]
    return found
