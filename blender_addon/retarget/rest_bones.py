"""A rig that plays: its bones at rest on a stage of their own, without moving one."""

from __future__ import annotations

import bpy
import numpy as np

from ..errors import ActorMissing
from .hanging import Hanging
from .maps.rig_map import RigMap
from .motion.figures import Target
from .rest_stage import stand_on_stage


def stand_at_rest(armature: bpy.types.Object, rig_map: RigMap, unit_m: float) -> Target:
    """Return the bones of a map at rest, feet on the stage's floor.

    Args:
        armature: the rig.
        rig_map: its bones by role; those that it lacks are left out.
        unit_m: metres of one unit of the armature's space.

    Raises:
        ActorMissing: the map has no pelvis.
        MapInvalid: it does not show left and right.
    """
    bones = {role: bone for role, bone in rig_map.bones.items() if bone in armature.data.bones}
    if "pelvis" not in bones:
        message = " ".join(rig_map.doubts) or "Neither names nor structure show a person."
        raise ActorMissing("The actor's pelvis was not found.", where=armature.name, hint=message)
    roles = tuple(role for role in bones if role != "root" and not role.endswith(("_ik", "_pole")))
    names = tuple(bones[role] for role in roles)
    matrices = np.array([armature.data.bones[name].matrix_local for name in names], np.float64)
    nobody = np.full(len(names), -1)
    rest = Hanging(names, matrices, nobody, nobody, (), (), ())
    posed = {role: bone for role, bone in bones.items() if role in roles}
    return stand_on_stage(armature, rest, roles, posed, unit_m)[0]
