"""The rig at rest on its stage: which way is up, what faces forward, where the soles stand."""

from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np

from .._exchange.rigs.rest_frames import stage_axes
from .._exchange.rigs.roles import LIMBS, SIDES
from ..errors import MapInvalid
from .extremities import end_of, estimate_sole, legs_of, measure_sole
from .hanging import Hanging
from .motion.figures import Target
from .part_skin import skin_by_part

_NEAR_FLOOR = 0.035
"""Share of the figure's height within which the armature's origin is its floor, where no skin shows the soles."""


def stand_on_stage(
    armature: bpy.types.Object, hanging: Hanging, roles: tuple[str, ...], bones: dict[str, str], unit_m: float
) -> tuple[Target, str]:
    """Return the rig with its soles at z = 0, facing -Y, and what shows the soles: ``mesh`` or ``joints``.

    An armature that the world shows mirrored stands on the stage as the world shows it: its right limbs play left.

    Args:
        armature: the rig.
        hanging: its controls.
        roles: of each control.
        bones: by role, fingers included.
        unit_m: metres of one unit of the armature's space.

    Raises:
        MapInvalid: the map does not show left and right.
    """
    heads = hanging.matrices[:, :3, 3]
    R = stage_axes(dict(zip(roles, heads, strict=True)))
    if R is None:
        hint = "Map both thighs or both upper arms, so that left and right are known."
        raise MapInvalid("The map does not show which side of the rig is left.", hint=hint)
    mirrored = armature.matrix_world.determinant() < 0
    if mirrored:
        R, roles = np.diag([-1.0, 1.0, 1.0]) @ R, tuple(_other_side(role) for role in roles)
    ends = np.array([_end(armature, heads, bones, hanging.names, c) for c in range(len(roles))])
    axes = hanging.matrices[:, :3, :3] / np.linalg.norm(hanging.matrices[:, :3, :3], axis=-2, keepdims=True)
    own = np.array([armature.data.bones[name].use_local_location for name in hanging.names])[:, None, None]
    target = Target(
        hanging.names, roles, unit_m * heads @ R.T, unit_m * ends @ R.T, R @ axes,
        np.where(own, R @ axes, R), hanging.turns_with, hanging.moves_with, R, unit_m, np.zeros(3),
    )  # fmt: skip
    sole, shown_by = _sole(armature, bones, R[2])
    ground = np.array([0.0, 0.0, unit_m * sole])
    skin = {
        _other_side(part) if mirrored else part: unit_m * points @ R.T - ground
        for part, points in skin_by_part(armature, bones).items()
    }
    standing = replace(target, heads=target.heads - ground, ends=target.ends - ground, ground=ground, skin=skin)
    return standing, shown_by


def _sole(armature: bpy.types.Object, bones: dict[str, str], up: np.ndarray) -> tuple[float, str]:
    """Return how high the soles are along ``up`` in the armature's units."""
    data, legs = armature.data.bones, legs_of(bones)
    if not legs:
        return 0.0, "joints"
    placed = [{part: np.array(data[name].head_local, np.float64) for part, name in leg.items()} for leg in legs]
    joints = [np.stack([heads[part] for part in ("thigh", "shin", "foot")]) for heads in placed]
    measured = [measure_sole(armature, leg, heads, up) for leg, heads in zip(legs, joints, strict=True)]
    if shown := [sole for sole in measured if sole is not None]:
        return min(shown), "mesh"
    low = min(estimate_sole(heads, places.get("toe"), up) for heads, places in zip(joints, placed, strict=True))
    height = max(np.array(bone.head_local, np.float64) @ up for bone in data) - low
    return (0.0 if abs(low) < _NEAR_FLOOR * height else low), "joints"


def _end(
    armature: bpy.types.Object, heads: np.ndarray, bones: dict[str, str], names: tuple[str, ...], control: int
) -> np.ndarray:
    role = next(role for role, bone in bones.items() if bone == names[control])
    limb = next((roles for roles in LIMBS.values() if roles[-1] == role and set(roles) <= bones.keys()), None)
    if limb is None:
        return np.full(3, np.nan)
    lower = heads[names.index(bones[limb[1]])]
    return end_of(armature, bones, role, float(np.linalg.norm(heads[control] - lower)))


def _other_side(role: str) -> str:
    for side, other in (SIDES, SIDES[::-1]):
        if role.startswith(f"{side}_"):
            return other + role.removeprefix(side)
    return role
