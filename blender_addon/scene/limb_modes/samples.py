"""Bones of an armature as they stand over some frames, and what their own channels must be for that."""

from __future__ import annotations

from collections.abc import Sequence

import bpy
import numpy as np

from ...conventions.timing import go_to_frame
from ..alone import alone


def sample_bones(
    armature: bpy.types.Object, scene: bpy.types.Scene, names: Sequence[str], times: np.ndarray | None
) -> dict[str, np.ndarray]:
    """Return the (F, 4, 4) matrix of each bone in the armature's frame, constraints and hand edits included.

    Args:
        armature: the armature.
        scene: the scene it is in.
        names: of the bones.
        times: (F,) scene frames; None for the pose it stands in now, which counts as one frame.
    """
    if times is None:
        bpy.context.view_layer.update()
        bones = armature.evaluated_get(bpy.context.evaluated_depsgraph_get()).pose.bones
        return {name: np.array(bones[name].matrix, np.float64)[None] for name in names}
    found = {name: np.empty((len(times), 4, 4)) for name in names}
    with alone(armature, scene) as (stage, depsgraph):
        for f, time in enumerate(times):
            go_to_frame(stage, float(time))
            bones = armature.evaluated_get(depsgraph).pose.bones
            for name in names:
                found[name][f] = bones[name].matrix
    return found


def own_channels(armature: bpy.types.Object, name: str, pose: np.ndarray, parent_pose: np.ndarray) -> np.ndarray:
    """Return the (F, 4, 4) matrices of a bone's own channels: ``B = L^-1 L_p P_p^-1 P``, L at rest and P posed.

    Args:
        armature: the armature.
        name: the bone; it has a parent.
        pose: (F, 4, 4) how it is to stand.
        parent_pose: (F, 4, 4) how its parent stands.
    """
    bone = armature.data.bones[name]
    rest, above = (np.array(b.matrix_local, np.float64) for b in (bone, bone.parent))
    return np.linalg.inv(rest) @ above @ np.linalg.inv(parent_pose) @ pose
