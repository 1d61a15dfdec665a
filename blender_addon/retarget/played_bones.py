"""What the bones of an armature show while it plays its action."""

from __future__ import annotations

from collections.abc import Sequence

import bpy
import numpy as np

from ..animation.curves import action_curves, current_action
from ..conventions.timing import go_to_frame
from ..errors import ActorMissing
from ..scene.alone import alone

_EVEN = 1e-3
"""Relative difference of scales that is none."""


def played_frames(armature: bpy.types.Object) -> tuple[str, np.ndarray]:
    """Return the name of the action that an armature plays and the (F,) scene frames that it covers.

    Raises:
        ActorMissing: it plays none, or one without keys.
    """
    action = current_action(armature)
    if action is None:
        hint = "Show one of its actions first, or choose the file with the clip."
        raise ActorMissing("The actor plays no action.", where=armature.name, hint=hint)
    if next(action_curves(action), None) is None:
        raise ActorMissing(f"The action '{action.name}' has no keys.", where=armature.name, hint="Choose another one.")
    first, last = action.frame_range
    return action.name, first + np.arange(1 + int(np.floor(last - first + 0.01)))


def played_bones(
    armature: bpy.types.Object, scene: bpy.types.Scene, times: np.ndarray, names: Sequence[str]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the object's (F, 4, 4) and the bones' (B, F, 4, 4) matrices, constraints and drivers included.

    Args:
        armature: the rig.
        scene: the scene it is in.
        times: (F,) scene frames.
        names: of B bones.

    Raises:
        ActorMissing: the armature is stretched, or bones are no numbers.
    """
    worlds, poses = np.empty((len(times), 4, 4)), np.empty((len(names), len(times), 4, 4))
    with alone(armature, scene) as (stage, depsgraph):
        for f, time in enumerate(times):
            go_to_frame(stage, float(time))
            shown = armature.evaluated_get(depsgraph)
            worlds[f] = shown.matrix_world
            poses[:, f] = [shown.pose.bones[name].matrix for name in names]
    if not (np.isfinite(worlds).all() and np.isfinite(poses).all()):
        hint = "Look for keys that are not numbers in the Graph Editor."
        raise ActorMissing(
            "The actor's bones have values that are not numbers on some frames.", where=armature.name, hint=hint
        )
    scale = np.linalg.norm(worlds[:, :3, :3], axis=1).mean(1)[:, None, None]
    axes = worlds[:, :3, :3] / np.maximum(scale, 1e-12)
    if np.abs(np.swapaxes(axes, -1, -2) @ axes - np.eye(3)).max() > _EVEN:
        hint = "Apply its scale (Object > Apply > Scale), or give it the same scale in all directions."
        raise ActorMissing("The actor's armature is stretched or flat.", where=armature.name, hint=hint)
    return worlds, poses


def bone_rotations(matrices: np.ndarray) -> np.ndarray:
    """Return the axes (..., 3, 3) of matrices (..., 4, 4), each of length 1."""
    R = matrices[..., :3, :3]
    return R / np.maximum(np.linalg.norm(R, axis=-2, keepdims=True), 1e-12)
