"""What the Retarget panel keeps in a scene."""

from __future__ import annotations

from typing import TYPE_CHECKING

import bpy

from .._exchange.errors import MocapError

if TYPE_CHECKING:
    from ..retarget.rig_map import RigMap


def _is_other_armature(self: bpy.types.PropertyGroup, obj: bpy.types.Object) -> bool:
    return obj.type == "ARMATURE" and obj not in (self.id_data.mocap.review.armature, self.actor)


def _is_other_than_target(self: bpy.types.PropertyGroup, obj: bpy.types.Object) -> bool:
    return obj.type == "ARMATURE" and obj != self.target


def _map_target(self: bpy.types.PropertyGroup, context: bpy.types.Context) -> None:
    """Map the target that was chosen, where its bones show what they are."""
    from ..retarget.recognition import map_rig, user_presets_folder

    self.table.clear()
    self.label = self.map_text = self.doubts = ""
    try:
        if self.target is not None:
            show_map(self, map_rig(self.target, user_presets_folder()))
    except MocapError as error:  # a preset of the user's that is damaged
        self.doubts = str(error)


def show_map(settings: bpy.types.PropertyGroup, rig_map: RigMap) -> None:
    """Write a map into the table, with a row for every role that a person can fill."""
    import json

    from .._exchange.rigs.roles import JOINT_OF, order_of
    from ..retarget.rig_map import map_values

    settings.table.clear()
    settings.label, settings.map_text = rig_map.label, json.dumps(map_values(rig_map))
    settings.doubts = "\n".join(rig_map.doubts)
    for role in sorted({*rig_map.bones, *JOINT_OF}, key=order_of):
        row = settings.table.add()
        row.name, row.bone = role, rig_map.bones.get(role, "")


class MocapRole(bpy.types.PropertyGroup):
    """One row of the table: a role and the bone that plays it."""

    bone: bpy.props.StringProperty(name="Bone", description="Bone of the rig that plays this role; empty for none")


class MocapRetarget(bpy.types.PropertyGroup):
    """How to retarget."""

    actor: bpy.props.PointerProperty(
        type=bpy.types.Object, name="Actor", description="Armature that has the motion; empty for the solved body",
        poll=_is_other_than_target,
    )  # fmt: skip
    target: bpy.props.PointerProperty(
        type=bpy.types.Object, name="Target", description="Armature of the character that gets the motion",
        poll=_is_other_armature, update=_map_target,
    )  # fmt: skip
    label: bpy.props.StringProperty(name="Map", description="Preset that the table came from")
    table: bpy.props.CollectionProperty(type=MocapRole, name="Table", description="Which bone plays which role")
    doubts: bpy.props.StringProperty(name="Doubts", description="What is uncertain about the map, a line each")
    map_text: bpy.props.StringProperty(name="Map Text", description="The whole map, its switches and map pose included")
    limbs: bpy.props.EnumProperty(
        name="Limbs", description="What the rig's switches are set to; both sets of controls are keyed",
        items=(
            ("fk", "FK", "Limbs turn bone by bone: twist as the actor's"),
            ("ik", "IK", "Hands and feet are posed: easiest to edit, elbows and knees bend as pure hinges"),
        ),
    )  # fmt: skip
    way: bpy.props.EnumProperty(
        name="Root Motion", description="What carries the travel over the ground",
        items=(
            ("body", "On Hips", "The hips carry it"),
            ("root", "On Root", "The root bone carries it and the heading, smoothed"),
            ("place", "In Place", "It is left out"),
        ),
    )  # fmt: skip
    scale: bpy.props.FloatProperty(
        name="Scale", min=0.0, soft_max=10.0,
        description="Scale of the travel relative to the body's; 0 for the ratio of the legs",
    )  # fmt: skip


CLASSES = (MocapRole, MocapRetarget)
