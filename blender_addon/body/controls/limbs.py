"""Names of the bones and switches of the four IK limbs, and of the finger controls."""

from __future__ import annotations

from dataclasses import dataclass

import bpy

from ..._exchange.joint_sets import FINGERS, SIDES

ROOT = "root"  # The root bone, which lies on the floor at the armature's origin.


@dataclass(frozen=True)
class Limb:
    """A limb: its three joints, and the bones that pose it by IK."""

    side: str  # ``left`` or ``right``.
    kind: str  # ``arm`` or ``leg``.
    joints: tuple[str, str, str]  # Shoulder, elbow and wrist, or hip, knee and ankle.
    control: str  # The hand or foot control to move and rotate.
    pole: str  # The bone towards which the elbow or knee points.
    solved: tuple[str, str]  # The hidden upper and lower bones that Blender's IK poses.
    reach: str  # Hidden bone that ends at the limb's end in every shape. IK moves it to the control.
    turns: tuple[str, str]  # Bones that the joints follow. They add the twist that a hinge cannot make.
    keyed: tuple[str, ...]  # The bones that have keys in IK mode.
    switch: str  # Custom property of the root bone: 0 means FK, 1 means IK.
    label: str  # The name shown in the panel.
    collection: str  # The bone collection of the limb's controls, shown in IK mode.
    joint_collection: str  # The bone collection of the limb's joints, shown in FK mode.


def _limb(side: str, kind: str, parts: tuple[str, str, str], end_bone: str) -> Limb:
    upper, lower, end = (f"{side}_{part}" for part in parts)
    control, pole, turns = f"{side}_{end_bone}_ik", f"{lower}_pole", (f"{upper}_turn", f"{lower}_turn")
    bones = (upper, lower, end), control, pole, (f"{upper}_solved", f"{lower}_solved"), f"{end}_reach", turns
    label, place = f"{side.title()} {kind.title()}", f"{kind.title()} {side.title()}"
    keyed = control, pole, *turns
    return Limb(side, kind, *bones, keyed, f"{side}_{kind}_ik", label, f"IK {place}", f"FK {place}")


_SIDED = ("arm", ("shoulder", "elbow", "wrist"), "hand"), ("leg", ("hip", "knee", "ankle"), "foot")
LIMBS = tuple(_limb(side, *row) for row in _SIDED for side in ("left", "right"))
HELPERS = tuple(name for limb in LIMBS for name in (*limb.solved, limb.reach))
"""Names of the hidden IK bones."""
CONTROLS = tuple(name for limb in LIMBS for name in limb.keyed)  # All visible bones except the joints and the root.


def switch_path(limb: Limb) -> str:
    """Return the data path of a limb's IK switch, relative to the armature object."""
    return f'pose.bones["{ROOT}"]["{limb.switch}"]'


def limb_paths(limb: Limb) -> set[str]:
    """Return the data paths of all keys that pose a limb by IK."""
    moved = (f'pose.bones["{name}"].location' for name in (limb.control, limb.pole))
    turned = (f'pose.bones["{name}"].rotation_quaternion' for name in (limb.control, *limb.turns))
    return {*moved, *turned}


def has_limbs(armature: bpy.types.Object | None) -> bool:
    """Return whether an armature has the controls of all four limbs."""
    if armature is None or armature.type != "ARMATURE":
        return False
    bones = armature.pose.bones
    return ROOT in bones and all(
        name in bones and limb.switch in bones[ROOT] for limb in LIMBS for name in (*limb.keyed, *limb.solved)
    )


def limb_of(switch: str) -> Limb:
    """Return the limb of an IK switch, given the switch's property name."""
    return next(limb for limb in LIMBS if limb.switch == switch)


def show_limb(armature: bpy.types.Object, limb: Limb, *, from_end: bool) -> None:
    """Show the bones for a limb's IK or FK mode, and hide the bones for the other mode."""
    for name, shown in ((limb.collection, from_end), (limb.joint_collection, not from_end)):
        if (collection := armature.data.collections_all.get(name)) is not None:  # the user may have deleted it
            collection.is_visible = shown


def follow_mode(armature: bpy.types.Object, limb: Limb, *, from_end: bool) -> None:
    """Show the bones for a limb's new mode (IK or FK) if the bones for its previous mode are visible."""
    unfit = armature.data.collections_all.get(limb.joint_collection if from_end else limb.collection)
    if unfit is not None and unfit.is_visible:
        show_limb(armature, limb, from_end=from_end)


COLLECTION = "Finger Controls"  # Bone collection of the finger controls.
NAMES = ("Curl", "Spread", "Fist", "Fan")
"""Names of the constraints that make finger joints follow the finger control and the hand control."""


def finger_control(side: str, finger: str) -> str:
    """Return the name of the bone that curls and spreads a finger."""
    return f"{side}_{finger}_curl"


def fist_control(side: str) -> str:
    """Return the name of the bone that closes a hand into a fist."""
    return f"{side}_fist"


FINGER_CONTROLS = (*(finger_control(side, f) for side in SIDES for f in FINGERS), *map(fist_control, SIDES))


def has_finger_controls(armature: bpy.types.Object | None) -> bool:
    """Return whether an armature has the finger controls."""
    if armature is None or armature.type != "ARMATURE":
        return False
    return all(name in armature.pose.bones for name in FINGER_CONTROLS)


def control_paths(armature: bpy.types.Object) -> list[tuple[str, str]]:
    """Return the data path and the bone name of each channel of an armature's finger controls."""
    names = FINGER_CONTROLS if has_finger_controls(armature) else ()
    return [(f'pose.bones["{name}"].rotation_euler', name) for name in names]
