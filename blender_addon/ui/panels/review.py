"""Review: where to look, and what to do about it."""

from __future__ import annotations

import bpy

from ..._exchange.hand_points import FINGERS, SIDES
from ..._exchange.solve_settings import CLEAN_UP
from ...body.controls.limbs import LIMBS, ROOT, finger_control, fist_control, has_finger_controls, has_limbs
from ...body.shape import body_mesh, effect_of, look_key, sliders
from ...conventions.naming import counted
from ..layout import is_narrow, is_slim
from ..operators.base import current
from ..operators.import_motion import MOCAP_OT_add_gloves
from ..operators.review import (
    MOCAP_OT_clear_marks,
    MOCAP_OT_feet_to_floor,
    MOCAP_OT_lock_feet,
    MOCAP_OT_mark_gaps,
    MOCAP_OT_next_bad_range,
    MOCAP_OT_open_report,
    MOCAP_OT_pin_pose,
    MOCAP_OT_show_confidence,
    MOCAP_OT_switch_limbs,
    MOCAP_OT_unpin,
)
from ..operators.solve import MOCAP_OT_resolve_range, MOCAP_OT_solve
from ..operators.takes import (
    MOCAP_OT_delete_take,
    MOCAP_OT_mark_take,
    MOCAP_OT_push_down,
    MOCAP_OT_show_take,
    MOCAP_OT_thin_take,
)
from ..properties import MocapCapture, MocapReview
from ..setting_properties import names_of
from ..translation import CONTEXT
from .parts import BodyPanel, StagePanel, TakePanel, wrapped


class VIEW3D_PT_mocap_review(BodyPanel, bpy.types.Panel):
    """Looking at the current take."""

    stage = "EDIT"
    bl_idname = "VIEW3D_PT_mocap_review"
    bl_label = "Review"
    bl_order = 4

    def draw(self, context: bpy.types.Context) -> None:
        """Draw takes, confidence and the report."""
        layout, review = self.layout, context.scene.mocap.review
        take = review.take
        _draw_takes(layout, context.scene.mocap.capture, take)
        if take is None:
            return
        _draw_worst(layout, review, context.scene.frame_current)
        layout.operator(MOCAP_OT_show_confidence.bl_idname, icon="COLOR", depress=review.colours)
        row = layout.row(align=True)
        row.operator(MOCAP_OT_next_bad_range.bl_idname, text="Previous", icon="TRIA_LEFT").backwards = True
        row.operator(MOCAP_OT_next_bad_range.bl_idname, text="Next", icon="TRIA_RIGHT").backwards = False
        short = {"text": "Threshold", "text_ctxt": CONTEXT} if is_slim(context) else {}
        layout.prop(review, "below", slider=True, **short)
        layout.operator(MOCAP_OT_open_report.bl_idname, icon="URL")


class VIEW3D_PT_mocap_resolve(TakePanel, bpy.types.Panel):
    """Solving a frame range again."""

    bl_idname = "VIEW3D_PT_mocap_resolve"
    bl_parent_id = "VIEW3D_PT_mocap_review"
    bl_label = "Fix a Range"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the range, the pins and the button."""
        layout, review = self.layout, context.scene.mocap.review
        layout.enabled = not current.busy
        row = layout.column(align=True) if is_slim(context) else layout.row(align=True)
        row.prop(review, "first")
        row.prop(review, "last")
        layout.operator(MOCAP_OT_pin_pose.bl_idname, icon="PINNED")
        column = layout.column(align=True)
        for index, pin in enumerate(review.pins):
            line = column.row(align=True)
            outside = not review.first <= pin.frame <= review.last
            text = f"Frame {pin.frame}" + (" (outside the range)" if outside else "")
            line.label(text=text, icon="PINNED", translate=False)
            line.operator(MOCAP_OT_unpin.bl_idname, text="", icon="X", emboss=False).index = index
        button = layout.column()
        button.scale_y = 1.3
        button.operator(MOCAP_OT_resolve_range.bl_idname, icon="FILE_REFRESH")


class VIEW3D_PT_mocap_clean_up(TakePanel, bpy.types.Panel):
    """Cleaning up."""

    bl_idname = "VIEW3D_PT_mocap_clean_up"
    bl_parent_id = "VIEW3D_PT_mocap_review"
    bl_label = "Clean Up"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012 - Blender reads a plain set
    bl_order = 2

    def draw(self, context: bpy.types.Context) -> None:
        """Draw what is solved anew, the floor, and the gaps."""
        layout, settings = self.layout, context.scene.mocap
        if settings.capture.file:
            column = layout.column(align=True)
            column.enabled = not current.busy
            for name in names_of(CLEAN_UP):
                row = column.row(align=True)
                row.enabled = settings.solve.acts(name)
                row.prop(settings.solve, name)
            column.operator(MOCAP_OT_solve.bl_idname, text="Solve Again", icon="FILE_REFRESH")
        else:
            layout.operator(MOCAP_OT_lock_feet.bl_idname, icon="LOCKED")
        column = layout.column(align=True)
        column.prop(settings.review, "floor_offset")
        column.operator(MOCAP_OT_feet_to_floor.bl_idname, icon="SNAP_FACE")
        row = layout.row(align=True)
        row.operator(MOCAP_OT_mark_gaps.bl_idname, icon="MARKER_HLT")
        row.operator(MOCAP_OT_clear_marks.bl_idname, text="", icon="X")


class VIEW3D_PT_mocap_take(TakePanel, bpy.types.Panel):
    """What else may become of a take."""

    bl_idname = "VIEW3D_PT_mocap_take"
    bl_parent_id = "VIEW3D_PT_mocap_review"
    bl_label = "Take"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012 - Blender reads a plain set
    bl_order = 3

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the ways, and how far a thinned take is from the full one."""
        layout, take = self.layout, context.scene.mocap.review.take
        if "keys_deviation" in take:
            wrapped(layout, context, take["keys_deviation"], "INFO")
        column = layout.column(align=True)
        column.label(text="Reduce Keys", text_ctxt=CONTEXT)
        row = column.row(align=True)
        row.operator(MOCAP_OT_thin_take.bl_idname, text="Tolerance").by = "TOLERANCE"
        row.operator(MOCAP_OT_thin_take.bl_idname, text="Rate").by = "RATE"
        column.operator(MOCAP_OT_push_down.bl_idname, icon="NLA_PUSHDOWN")
        column.operator(MOCAP_OT_mark_take.bl_idname, icon="ASSET_MANAGER")


def _draw_takes(layout: bpy.types.UILayout, capture: MocapCapture, take: bpy.types.Action | None) -> None:
    from ...animation.takes import ERROR, takes_of

    takes = takes_of(capture.measured, capture.person.key if capture.person else "", capture.original)
    column = layout.column(align=True)
    for action in takes:
        row = column.row(align=True)
        if action == take:
            row.prop(action, "name", text="", icon="ACTION")
        else:
            text = ", ".join(part for part in (action.name, str(action.get(ERROR, ""))) if part)
            row.operator(MOCAP_OT_show_take.bl_idname, text=text, translate=False).name = action.name
        row.operator(MOCAP_OT_delete_take.bl_idname, text="", icon="TRASH").name = action.name
    if take is not None:
        column.label(text=_kept(take), icon="KEYFRAME", translate=False)


def _kept(take: bpy.types.Action) -> str:
    """Return how many keys a take has and how far its solve is from what was measured."""
    from ...animation.curves import action_curves
    from ...animation.takes import ERROR

    most = max((len(curve.keyframe_points) for curve in action_curves(take)), default=0)
    return ", ".join(part for part in (counted(most, "key"), str(take.get(ERROR, ""))) if part)


def _draw_worst(layout: bpy.types.UILayout, review: MocapReview, frame: int) -> None:
    from ...animation.lanes import current_confidence, resting_bones, sigma_of

    resting = resting_bones(review.armature, frame)
    if resting:
        text = counted(len(resting), "joint") + " at rest: nothing measured"
        layout.label(text=text, icon="GHOST_ENABLED", translate=False)
    confidence = {name: c for name, c in current_confidence(review.armature).items() if name not in resting}
    if not confidence:
        return
    worst = min(confidence, key=lambda name: confidence[name])
    value = confidence[worst]
    row = layout.row()
    spread = f"± {1000 * sigma_of(value):.0f} mm" if value > 0 else "bridged"
    icon = "INFO" if value < review.below else "CHECKMARK"
    row.label(text=f"{worst.replace('_', ' ')} {spread}", icon=icon, translate=False)


_SLIDER, _NARROW_SLIDER = 0.75, 0.82
"""Share of a line that a limb's slider has, also where the sidebar is narrow; the button beside it has the rest."""


class VIEW3D_PT_mocap_limbs(StagePanel, bpy.types.Panel):
    """The controls of the solved body."""

    stage = "EDIT"
    bl_idname = "VIEW3D_PT_mocap_limbs"
    bl_parent_id = "VIEW3D_PT_mocap_review"
    bl_label = "FK and IK"
    bl_order = 4

    @classmethod
    def has_subject(cls, settings: bpy.types.PropertyGroup) -> bool:
        """Return whether there is a body with controls."""
        return has_limbs(settings.review.armature)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw a switch a limb and, beside it, the button that keeps the motion."""
        layout = self.layout
        armature = context.scene.mocap.review.armature
        column = layout.column(align=True)
        share = _NARROW_SLIDER if is_narrow(context) else _SLIDER
        for limb in LIMBS:
            row = column.split(factor=share, align=True)
            row.prop(armature.pose.bones[ROOT], f'["{limb.switch}"]', text=limb.label, text_ctxt=CONTEXT, slider=True)
            to = "FK" if armature.pose.bones[ROOT][limb.switch] > 0 else "IK"
            _draw_switch(row, to, limb.switch, to)
        row = layout.row(align=True)
        _draw_switch(row, "IK", "ALL", "All to IK")
        _draw_switch(row, "FK", "ALL", "All to FK")
        wrapped(layout, context, "The buttons key the limbs so that the motion stays; the sliders only blend.", "INFO")


def _draw_switch(layout: bpy.types.UILayout, to: str, limb: str, text: str) -> None:
    button = layout.operator(MOCAP_OT_switch_limbs.bl_idname, text=text)
    button.to, button.limb = to, limb


_CURL, _SPREAD = 0, 2
"""Axes of a control by which it curls and spreads."""


class VIEW3D_PT_mocap_fingers(StagePanel, bpy.types.Panel):
    """The fingers of the solved body."""

    stage = "EDIT"
    bl_idname = "VIEW3D_PT_mocap_fingers"
    bl_parent_id = "VIEW3D_PT_mocap_review"
    bl_label = "Fingers"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012 - Blender reads a plain set
    bl_order = 5

    @classmethod
    def has_subject(cls, settings: bpy.types.PropertyGroup) -> bool:
        """Return whether there is a take, or a body with finger controls."""
        return settings.review.take is not None or has_finger_controls(settings.review.armature)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw what adds fingers, and the controls of both hands where the body has them."""
        column = self.layout.column()
        column.enabled = not current.busy
        column.operator(MOCAP_OT_add_gloves.bl_idname, icon="VIEW_PAN")
        armature = context.scene.mocap.review.armature
        if has_finger_controls(armature):
            self._draw_controls(context, armature.pose.bones)

    def _draw_controls(self, context: bpy.types.Context, bones: bpy.types.bpy_prop_collection) -> None:
        for side in SIDES:
            column = self.layout.column(align=True)
            column.label(text=f"{side.title()} Hand", text_ctxt=CONTEXT)
            rows = [("Fist", fist_control(side)), *((f.title(), finger_control(side, f)) for f in FINGERS)]
            for label, name in rows:
                row = column.row(align=True)
                row.prop(bones[name], "rotation_euler", index=_CURL, text=label, text_ctxt=CONTEXT)
                row.prop(bones[name], "rotation_euler", index=_SPREAD, text="Spread", text_ctxt=CONTEXT)
        wrapped(self.layout, context, "Controls add to what the finger bones are keyed to.", "INFO")


class VIEW3D_PT_mocap_shape(StagePanel, bpy.types.Panel):
    """The shape of the solved body."""

    stage = "EDIT"
    bl_idname = "VIEW3D_PT_mocap_shape"
    bl_parent_id = "VIEW3D_PT_mocap_review"
    bl_label = "Body Shape"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012 - Blender reads a plain set
    bl_order = 2

    @classmethod
    def has_subject(cls, settings: bpy.types.PropertyGroup) -> bool:
        """Return whether there is a body with sliders."""
        armature = settings.review.armature
        return armature is not None and body_mesh(armature) is not None

    def draw(self, context: bpy.types.Context) -> None:
        """Draw one slider a component."""
        mesh = body_mesh(context.scene.mocap.review.armature)
        assert mesh is not None  # polled
        if look_key(mesh) is not None:
            self.layout.row().prop(context.scene.mocap, "look", expand=True, text_ctxt=CONTEXT)
        column = self.layout.column(align=True)
        for key in sliders(mesh):
            effect = effect_of(key)
            if is_slim(context):
                column.label(text=effect, text_ctxt=CONTEXT)
                effect = ""
            column.prop(key, "value", text=effect, text_ctxt=CONTEXT, slider=True)
