"""The four limbs with IK, the controls of fingers, and the names of their bones and switches."""

from __future__ import annotations

from dataclasses import dataclass

import bpy

from ..._exchange.joint_sets import FINGERS, SIDES

ROOT = "root"  # The bone that carries everything, on the floor at the armature's origin.


@dataclass(frozen=True)
class Limb:
    """One limb: three joints, and the bones that pose it from its end (IK)."""

    side: str  # ``left`` or ``right``.
    kind: str  # ``arm`` or ``leg``.

    @property
    def joints(self) -> tuple[str, str, str]:
        """Shoulder, elbow and wrist, or hip, knee and ankle."""
        parts = ("shoulder", "elbow", "wrist") if self.kind == "arm" else ("hip", "knee", "ankle")
        upper, lower, end = (f"{self.side}_{part}" for part in parts)
        return upper, lower, end

    @property
    def control(self) -> str:
        """The hand or foot to place and turn."""
        return f"{self.side}_{'hand' if self.kind == 'arm' else 'foot'}_ik"

    @property
    def pole(self) -> str:
        """The bone that the elbow or knee points to."""
        return f"{self.joints[1]}_pole"

    @property
    def solved(self) -> tuple[str, str]:
        """The hidden upper and lower bones that Blender's IK poses."""
        return f"{self.joints[0]}_solved", f"{self.joints[1]}_solved"

    @property
    def reach(self) -> str:
        """The hidden bone with its tail at the limb's end in every shape, which IK brings to the control."""
        return f"{self.joints[2]}_reach"

    @property
    def turns(self) -> tuple[str, str]:
        """Bones that lead the joints, turned against the solved bones by the twist and whatever a hinge cannot show."""
        return f"{self.joints[0]}_turn", f"{self.joints[1]}_turn"

    @property
    def keyed(self) -> tuple[str, ...]:
        """The bones with keys in IK."""
        return self.control, self.pole, *self.turns

    @property
    def switch(self) -> str:
        """Custom property of the root bone: 0 for FK, 1 for IK."""
        return f"{self.side}_{self.kind}_ik"

    @property
    def label(self) -> str:
        """Name in the panel."""
        return f"{self.side.title()} {self.kind.title()}"

    @property
    def collection(self) -> str:
        """The bone collection of its controls, shown in IK."""
        return f"IK {self.kind.title()} {self.side.title()}"

    @property
    def joint_collection(self) -> str:
        """The bone collection of its joints, shown in FK."""
        return f"FK {self.kind.title()} {self.side.title()}"


LIMBS = tuple(Limb(side, kind) for kind in ("arm", "leg") for side in ("left", "right"))
HELPERS = tuple(name for limb in LIMBS for name in (*limb.solved, limb.reach))
"""Hidden bones."""
CONTROLS = tuple(name for limb in LIMBS for name in limb.keyed)  # Visible bones, besides the joints and the root.


def switch_path(limb: Limb) -> str:
    """Return the data path of a limb's switch in its armature object."""
    return f'pose.bones["{ROOT}"]["{limb.switch}"]'


def has_limbs(armature: bpy.types.Object | None) -> bool:
    """Return whether an armature has all controls of limbs."""
    if armature is None or armature.type != "ARMATURE":
        return False
    bones = armature.pose.bones
    return ROOT in bones and all(
        name in bones and limb.switch in bones[ROOT] for limb in LIMBS for name in (*limb.keyed, *limb.solved)
    )


def limb_of(switch: str) -> Limb:
    """Return the limb with this switch."""
    return next(limb for limb in LIMBS if limb.switch == switch)


def show_limb(armature: bpy.types.Object, limb: Limb, *, from_end: bool) -> None:
    """Show the bones of a limb in one of its modes, and hide those of the other."""
    for name, shown in ((limb.collection, from_end), (limb.joint_collection, not from_end)):
        if (collection := armature.data.collections_all.get(name)) is not None:  # the user may delete it
            collection.is_visible = shown


def follow_mode(armature: bpy.types.Object, limb: Limb, *, from_end: bool) -> None:
    """Show a limb's bones in the mode of another take. Bones hidden by the user stay hidden."""
    unfit = armature.data.collections_all.get(limb.joint_collection if from_end else limb.collection)
    if unfit is not None and unfit.is_visible:
        show_limb(armature, limb, from_end=from_end)


COLLECTION = "Finger Controls"  # Bone collection of the finger controls.
NAMES = ("Curl", "Spread", "Fist", "Fan")
"""Names of the constraints by which joints follow a finger's control and a hand's."""


def finger_control(side: str, finger: str) -> str:
    """Return the name of the bone that curls and spreads a finger."""
    return f"{side}_{finger}_curl"


def fist_control(side: str) -> str:
    """Return the name of the bone that makes a fist."""
    return f"{side}_fist"


FINGER_CONTROLS = (*(finger_control(side, f) for side in SIDES for f in FINGERS), *map(fist_control, SIDES))


def has_finger_controls(armature: bpy.types.Object | None) -> bool:
    """Return whether an armature has the controls of fingers."""
    if armature is None or armature.type != "ARMATURE":
        return False
    return all(name in armature.pose.bones for name in FINGER_CONTROLS)


def control_paths(armature: bpy.types.Object) -> list[tuple[str, str]]:
    """Return data path and bone of the channels of an armature's finger controls."""
    names = FINGER_CONTROLS if has_finger_controls(armature) else ()
    return [(f'pose.bones["{name}"].rotation_euler', name) for name in names]
