"""Limbs posed joint by joint or from their ends."""

from __future__ import annotations

import bpy

from ...conventions.counting import counted
from .base import NeedsBody

_LIMBS = (
    ("ALL", "All Limbs", "Both arms and both legs"),
    ("left_arm_ik", "Left Arm", ""),
    ("right_arm_ik", "Right Arm", ""),
    ("left_leg_ik", "Left Leg", ""),
    ("right_leg_ik", "Right Leg", ""),
)


class MOCAP_OT_limbs_to_ik(NeedsBody, bpy.types.Operator):
    """Switches limbs to IK, the motion kept."""

    bl_idname = "mocap.limbs_to_ik"
    bl_label = "To IK"
    bl_description = (
        "Key hands, feet and poles so that the motion stays as it is, and pose these limbs from their ends. Without an "
        "action the pose alone is set"
    )

    limb: bpy.props.EnumProperty(name="Limb", items=_LIMBS, default="ALL")

    def work(self, context: bpy.types.Context) -> set[str]:
        """Key the controls, and switch."""
        from ...scene.limb_modes.switching import pose_from_ends

        frames = pose_from_ends(context.scene.mocap.review.armature, context.scene, chosen_limbs(self.limb))
        self.report({"INFO"}, f"IK: {counted(frames, 'frame')} keyed" if frames else "IK: the pose is set")
        return {"FINISHED"}


class MOCAP_OT_limbs_to_fk(NeedsBody, bpy.types.Operator):
    """Switches limbs to FK, the motion kept."""

    bl_idname = "mocap.limbs_to_fk"
    bl_label = "To FK"
    bl_description = (
        "Key the joints so that the motion stays as it is, with what was edited by IK, and pose these limbs joint by "
        "joint. Without an action the pose alone is set"
    )

    limb: bpy.props.EnumProperty(name="Limb", items=_LIMBS, default="ALL")

    def work(self, context: bpy.types.Context) -> set[str]:
        """Key the joints, and switch."""
        from ...scene.limb_modes.switching import pose_by_joints

        frames = pose_by_joints(context.scene.mocap.review.armature, context.scene, chosen_limbs(self.limb))
        self.report({"INFO"}, f"FK: {counted(frames, 'frame')} keyed" if frames else "FK: the pose is set")
        return {"FINISHED"}


def chosen_limbs(choice: str) -> tuple:
    """Return the limbs of a choice."""
    from ...body.controls.limbs import LIMBS, limb_of

    return LIMBS if choice == "ALL" else (limb_of(choice),)


CLASSES = (MOCAP_OT_limbs_to_ik, MOCAP_OT_limbs_to_fk)
