"""The four limbs that can be posed from their ends, and the names of the bones and switches that do it."""

from __future__ import annotations

from dataclasses import dataclass

import bpy

from ..._exchange.hand_points import FINGERS, SIDES

ROOT = "root"
"""The bone that carries everything; it lies on the floor at the armature's origin."""


@dataclass(frozen=True)
class Limb:
    """One limb: three joints, and the bones that pose it from its end."""

    side: str
    """``left`` or ``right``."""
    kind: str
    """``arm`` or ``leg``."""

    @property
    def joints(self) -> tuple[str, str, str]:
        """The joints that the limb's end leads: shoulder, elbow, wrist, or hip, knee, ankle."""
        parts = ("shoulder", "elbow", "wrist") if self.kind == "arm" else ("hip", "knee", "ankle")
        upper, lower, end = (f"{self.side}_{part}" for part in parts)
        return upper, lower, end

    @property
    def control(self) -> str:
        """The hand or foot to place and turn."""
        return f"{self.side}_{'hand' if self.kind == 'arm' else 'foot'}_ik"

    @property
    def pole(self) -> str:
        """Where the elbow or knee points."""
        return f"{self.joints[1]}_pole"

    @property
    def solved(self) -> tuple[str, str]:
        """The hidden bones that Blender's IK poses: upper and lower."""
        return f"{self.joints[0]}_solved", f"{self.joints[1]}_solved"

    @property
    def reach(self) -> str:
        """The hidden bone whose tail is the limb's end at every shape; IK brings it to the control."""
        return f"{self.joints[2]}_reach"

    @property
    def turns(self) -> tuple[str, str]:
        """Turned against the solved bones: the twist, and whatever else a hinge cannot show. They lead the joints."""
        return f"{self.joints[0]}_turn", f"{self.joints[1]}_turn"

    @property
    def keyed(self) -> tuple[str, ...]:
        """The bones that are keyed where the limb is posed from its end."""
        return self.control, self.pole, *self.turns

    @property
    def switch(self) -> str:
        """Custom property of the root bone: 0 poses joint by joint (FK), 1 from the end (IK)."""
        return f"{self.side}_{self.kind}_ik"

    @property
    def collection(self) -> str:
        """The bone collection of its controls, shown while it is posed from its end."""
        return f"IK {self.kind.title()} {self.side.title()}"

    @property
    def joint_collection(self) -> str:
        """The bone collection of the joints that its end leads, shown while it is posed joint by joint."""
        return f"FK {self.kind.title()} {self.side.title()}"

    @property
    def label(self) -> str:
        """What the panel calls it."""
        return f"{self.side.title()} {self.kind.title()}"


LIMBS = tuple(Limb(side, kind) for kind in ("arm", "leg") for side in ("left", "right"))
HELPERS = tuple(name for limb in LIMBS for name in (*limb.solved, limb.reach))
"""Bones that nobody sees."""
CONTROLS = tuple(name for limb in LIMBS for name in limb.keyed)
"""Bones that animators see besides the joints and the root."""


def switch_path(limb: Limb) -> str:
    """Return the data path of a limb's switch in its armature object."""
    return f'pose.bones["{ROOT}"]["{limb.switch}"]'


def has_limbs(armature: bpy.types.Object | None) -> bool:
    """Return whether an armature has the controls of this version; bodies of earlier ones have only joints."""
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
    """Show the bones that pose a limb in one of its modes, and hide those of the other."""
    for name, shown in ((limb.collection, from_end), (limb.joint_collection, not from_end)):
        if (collection := armature.data.collections_all.get(name)) is not None:  # not in bodies of earlier versions
            collection.is_visible = shown


def follow_mode(armature: bpy.types.Object, limb: Limb, *, from_end: bool) -> None:
    """Show a limb's bones as another take poses it; what the user hid stays hidden."""
    unfit = armature.data.collections_all.get(limb.joint_collection if from_end else limb.collection)
    if unfit is not None and unfit.is_visible:
        show_limb(armature, limb, from_end=from_end)


COLLECTION = "Finger Controls"
"""Bone collection of the controls."""
NAMES = ("Curl", "Spread", "Fist", "Fan")
"""Of the constraints by which joints follow a finger's control and a hand's."""


def finger_control(side: str, finger: str) -> str:
    """Return the name of the bone that curls and spreads a finger."""
    return f"{side}_{finger}_curl"


def fist_control(side: str) -> str:
    """Return the name of the bone that makes a fist."""
    return f"{side}_fist"


FINGER_CONTROLS = tuple(finger_control(side, finger) for side in SIDES for finger in FINGERS) + tuple(
    fist_control(side) for side in SIDES
)
"""All controls of fingers."""


def has_finger_controls(armature: bpy.types.Object | None) -> bool:
    """Return whether an armature has these controls."""
    return (
        armature is not None
        and armature.type == "ARMATURE"
        and all(name in armature.pose.bones for name in FINGER_CONTROLS)
    )


def control_paths(armature: bpy.types.Object) -> list[tuple[str, str]]:
    """Return data path and bone of the channels of the controls that an armature has."""
    if not has_finger_controls(armature):
        return []
    return [(f'pose.bones["{name}"].rotation_euler', name) for name in FINGER_CONTROLS]
