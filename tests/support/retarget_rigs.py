"""The rigs that retargeting is tried on, with the bones that show their limbs."""

from __future__ import annotations

import bpy

from blender_addon.retarget.recognition import map_rig
from blender_addon.retarget.rig_map import RigMap
from tests.support.mixamo_rig import PREFIX, mixamo_rig
from tests.support.retarget_measures import Limb, bent_hinge
from tests.support.rigify_rig import rigify_rig

_SIDES = (("left", "Left"), ("right", "Right"))


def mixamo_limbs(prefix: str = PREFIX) -> dict[str, Limb]:
    """Return the limbs of ``mixamo_rig``."""
    parts = {"arm": ("Arm", "ForeArm", "Hand"), "leg": ("UpLeg", "Leg", "Foot", "ToeBase")}
    return {
        f"{side}_{limb}": Limb(tuple(f"{prefix}{word}{part}" for part in names))
        for side, word in _SIDES
        for limb, names in parts.items()
    }


def mixamo(build: str = "short", **options: object) -> tuple[bpy.types.Object, dict[str, Limb]]:
    """Build a Mixamo rig."""
    return mixamo_rig(build=build, **options), mixamo_limbs()


def rigify() -> tuple[bpy.types.Object, dict[str, Limb]]:
    """Generate a Rigify rig; its limbs are shown by the bones that the skin follows, however it is posed."""
    rig, limbs = rigify_rig(), {}
    parts = {"arm": ("upper_arm", "forearm", "hand"), "leg": ("thigh", "shin", "foot", "toe")}
    for side, word in _SIDES:
        for limb, names in parts.items():
            bones = tuple(f"ORG-{name}.{word[0]}" for name in names)
            limbs[f"{side}_{limb}"] = Limb(bones, bent_hinge(rig, *bones[:2]))
    return rig, limbs


def map_of_rig(rig: bpy.types.Object) -> RigMap:
    """Return the map that is found for a rig."""
    return map_rig(rig)
