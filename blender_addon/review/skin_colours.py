"""A skin's colours by the confidence of the joints that lead it, and the stretches of a take that are doubtful."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import bpy
import numpy as np

from ..animation.lanes import read_lane
from ..body.armature import deform_bone
from .bone_colours import RESTING, colours
from .ranges import bad_ranges

_BRIDGED = 1e-3
"""Confidence below which a frame was bridged: nobody saw it (``confidence.joint_confidence``)."""


def joint_weights(skin: bpy.types.Object, joints: tuple[str, ...]) -> np.ndarray:
    """Return (V, J) shares of each vertex's weights that joints have; a vertex of none has zeros.

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
    """Return (V, 3) display colours of a skin, grey around joints at rest; those without a confidence are certain.

    Args:
        weights: (V, J) from ``joint_weights``.
        joints: their names.
        confidence: by joint, in 0..1.
        resting: joints that nothing measured.
    """
    rests = np.array([name in resting for name in joints])
    shown = weights @ np.where(rests, 1.0, [confidence.get(name, 1.0) for name in joints])
    share = weights[:, rests].sum(axis=1, keepdims=True)
    return (1.0 - share) * colours(shown) + share * RESTING


def doubtful_bands(take: bpy.types.Action, below: float) -> list[tuple[float, float, tuple[float, float, float]]]:
    """Return first and last scene frame and colour of each stretch below a bound; what was bridged is red.

    Args:
        take: the take.
        below: confidence from which on a frame is not doubtful.
    """
    lane = read_lane(take)
    if lane is None:
        return []
    frames, confidence = lane
    found = []
    for bound in (below, min(below, _BRIDGED)):
        shade = colours(0.6 if bound == below else 0.0)
        found += [
            (float(frames[a]), float(frames[b]), tuple(shade)) for a, b in bad_ranges(confidence, bound, bridge=0)
        ]
    return found
