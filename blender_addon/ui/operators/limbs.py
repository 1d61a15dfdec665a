"""Limbs posed joint by joint or from their ends."""

from __future__ import annotations

import bpy

from ...conventions.naming import counted
from .base import NeedsBody

_LIMBS = (
    ("ALL", "All Limbs", "Both arms and both legs"),
    ("left_arm_ik", "Left Arm", ""),
    ("right_arm_ik", "Right Arm", ""),
    ("left_leg_ik", "Left Leg", ""),
    ("right_leg_ik", "Right Leg", ""),
)
_MODES = (
    ("IK", "IK", "Key hands, feet and poles, and pose limbs from their ends"),
    ("FK", "FK", "Key the joints with what was edited by IK, and pose limbs joint by joint"),
)


class MOCAP_OT_switch_limbs(NeedsBody, bpy.types.Operator):
    """Switches limbs to IK or to FK, the motion kept."""

    bl_idname = "mocap.switch_limbs"
    bl_label = "Switch Limbs"
    bl_description = (
        "Pose limbs from their ends (IK) or joint by joint (FK), keyed so that the motion stays as it is. Without an "
        "action the pose alone is set"
    )
    edits_body = True

    to: bpy.props.EnumProperty(name="To", items=_MODES, default="IK")
    limb: bpy.props.EnumProperty(name="Limb", items=_LIMBS, default="ALL")

    def work(self, context: bpy.types.Context) -> set[str]:
        """Key what the mode poses by, and switch."""
        from ...body.controls.limbs import LIMBS, limb_of
        from ...scene.limb_modes import pose_by_joints, pose_from_ends

        limbs = LIMBS if self.limb == "ALL" else (limb_of(self.limb),)
        switch = pose_from_ends if self.to == "IK" else pose_by_joints
        frames = switch(context.scene.mocap.review.armature, context.scene, limbs)
        what = f"{counted(frames, 'frame')} keyed" if frames else "the pose is set"
        self.report({"INFO"}, f"{self.to}: {what}")
        return {"FINISHED"}


CLASSES = (MOCAP_OT_switch_limbs,)
