"""What the Retarget panel keeps in a scene."""

from __future__ import annotations

import bpy


def _is_other_armature(self: bpy.types.PropertyGroup, obj: bpy.types.Object) -> bool:
    return obj.type == "ARMATURE" and obj not in (self.id_data.mocap.review.armature, self.actor)


def _is_other_than_target(self: bpy.types.PropertyGroup, obj: bpy.types.Object) -> bool:
    return obj.type == "ARMATURE" and obj != self.target


def _forget_table(self: bpy.types.PropertyGroup, context: bpy.types.Context) -> None:
    self.table.clear()
    self.label = self.map_text = ""


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
        poll=_is_other_armature, update=_forget_table,
    )  # fmt: skip
    label: bpy.props.StringProperty(name="Map", description="Preset that the table came from")
    table: bpy.props.CollectionProperty(type=MocapRole, name="Table", description="Which bone plays which role")
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
        name="Scale", description="Size of the way by the body's; 0 for the ratio of the legs", min=0.0, soft_max=10.0,
    )  # fmt: skip


CLASSES = (MocapRole, MocapRetarget)
