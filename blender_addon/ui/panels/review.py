"""Panels of the Edit stage: review a take, fix a range, clean up, and pose shape, limbs and fingers."""

from __future__ import annotations

import bpy

from ..._exchange.joint_sets import FINGERS, SIDES
from ..._exchange.solve_settings import CLEAN_UP
from ...body.controls.limbs import LIMBS, ROOT, finger_control, fist_control, has_finger_controls, has_limbs
from ...conventions.naming import counted
from ..layout import draw_button, is_narrow, is_slim, wrapped
from ..operators.base import BODY, TAKE, current
from ..operators.solve import runs
from ..operators.takes import takes_of_person
from ..properties import MocapReview
from ..setting_properties import names_of
from ..translation import CONTEXT
from ..viewport import ghost_of
from .parts import panel

_CURL, _SPREAD = 0, 2  # Axes of a finger control.
_SLIDER, _NARROW_SLIDER = 0.75, 0.82
"""Width of a limb's slider as a fraction of the row, in a wide and in a narrow sidebar. The rest is a button."""


@panel("Review", "EDIT", order=4, needs=BODY.is_met)
def review(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    settings = context.scene.mocap.review
    take = settings.take
    _draw_takes(layout, context.scene.mocap, take)
    if take is None:
        return
    _draw_worst(layout, settings, context.scene.frame_current)
    layout.operator("mocap.show_confidence", icon="COLOR", depress=settings.colours)
    row = layout.row(align=True)
    row.operator("mocap.next_bad_range", text="Previous", icon="TRIA_LEFT").backwards = True
    row.operator("mocap.next_bad_range", text="Next", icon="TRIA_RIGHT").backwards = False
    short = {"text": "Threshold", "text_ctxt": CONTEXT} if is_slim(context) else {}
    layout.prop(settings, "below", slider=True, **short)
    layout.operator("mocap.open_report", icon="URL")


def _draw_takes(layout: bpy.types.UILayout, settings: bpy.types.PropertyGroup, take: bpy.types.Action | None) -> None:
    from ...animation.curves import action_curves
    from ...animation.takes import ERROR

    column, ghost = layout.column(align=True), ghost_of(settings.review)
    for action in takes_of_person(settings):
        row = column.row(align=True)
        if action == take:
            row.prop(action, "name", text="", icon="ACTION")
        else:
            text = ", ".join(part for part in (action.name, str(action.get(ERROR, ""))) if part)
            row.operator("mocap.show_take", text=text, translate=False).name = action.name
            if take is not None:
                pressed = ghost is not None and ghost.take == action.session_uid
                row.operator("mocap.ghost_take", text="", icon="GHOST_ENABLED", depress=pressed).name = action.name
        row.operator("mocap.delete_take", text="", icon="TRASH").name = action.name
    if take is not None:
        most = max((len(curve.keyframe_points) for curve in action_curves(take)), default=0)
        text = ", ".join(part for part in (counted(most, "key"), str(take.get(ERROR, ""))) if part)
        column.label(text=text, icon="KEYFRAME", translate=False)


def _draw_worst(layout: bpy.types.UILayout, settings: MocapReview, frame: int) -> None:
    from ...animation.lanes import current_confidence, resting_bones, sigma_of

    resting = resting_bones(settings.armature, frame)
    if resting:
        text = counted(len(resting), "joint") + " at rest: not measured"
        layout.label(text=text, icon="GHOST_ENABLED", translate=False)
    confidence = {name: c for name, c in current_confidence(settings.armature).items() if name not in resting}
    if not confidence:
        return
    worst = min(confidence, key=lambda name: confidence[name])
    value = confidence[worst]
    spread = f"± {1000 * sigma_of(value):.0f} mm" if value > 0 else "interpolated"
    icon = "INFO" if value < settings.below else "CHECKMARK"
    layout.row().label(text=f"{worst.replace('_', ' ')} {spread}", icon=icon, translate=False)


@panel("Fix a Range", "EDIT", parent="review", needs=TAKE.is_met)
def resolve(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    settings = context.scene.mocap.review
    layout.enabled = not current.busy
    row = layout.column(align=True) if is_slim(context) else layout.row(align=True)
    row.prop(settings, "first")
    row.prop(settings, "last")
    layout.operator("mocap.pin_pose", icon="PINNED")
    column = layout.column(align=True)
    for first, last in runs(sorted(pin.frame for pin in settings.pins)):
        line = column.row(align=True)
        outside = last < settings.first or first > settings.last
        text = f"Frame {first}" if first == last else f"Frames {first}-{last}"
        line.label(text=text + (" (outside the range)" if outside else ""), icon="PINNED", translate=False)
        button = line.operator("mocap.unpin", text="", icon="X", emboss=False)
        button.first, button.last = first, last
    if len(settings.pins) > 1:
        column.operator("mocap.clear_pins", icon="X")
    column = layout.column(align=True)
    column.operator("mocap.add_contact", icon="ADD")
    column.operator("mocap.remove_contact", icon="REMOVE")
    column.operator("mocap.clear_contacts", icon="X")
    draw_button(layout, "mocap.resolve_range", "FILE_REFRESH", 1.3)
    column = layout.column(align=True)
    column.operator("mocap.denoise_range", icon="SMOOTHCURVE")
    column.operator("mocap.complete_limb", icon="CON_ARMATURE")
    column.operator("mocap.fill_between", icon="IPO_EASE_IN_OUT")


@panel("Clean Up", "EDIT", parent="review", order=2, closed=True, needs=TAKE.is_met)
def clean_up(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    settings = context.scene.mocap
    if settings.capture.file:
        column = layout.column(align=True)
        column.enabled = not current.busy
        for name in names_of(CLEAN_UP):
            row = column.row(align=True)
            row.enabled = settings.solve.acts(name)
            row.prop(settings.solve, name)
        column.operator("mocap.solve", text="Solve Again", icon="FILE_REFRESH")
    else:
        layout.operator("mocap.lock_feet", icon="LOCKED")
    column = layout.column(align=True)
    column.prop(settings.review, "floor_offset")
    column.operator("mocap.feet_to_floor", icon="SNAP_FACE")
    row = layout.row(align=True)
    row.operator("mocap.mark_gaps", icon="MARKER_HLT")
    row.operator("mocap.clear_marks", text="", icon="X")


@panel("Take", "EDIT", parent="review", order=3, closed=True, needs=TAKE.is_met)
def take(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    action = context.scene.mocap.review.take
    if "keys_deviation" in action:
        wrapped(layout, context, action["keys_deviation"], "INFO")
    column = layout.column(align=True)
    column.label(text="Reduce Keys", text_ctxt=CONTEXT)
    row = column.row(align=True)
    row.operator("mocap.thin_take", text="Tolerance").by = "TOLERANCE"
    row.operator("mocap.thin_take", text="Rate").by = "RATE"
    column.operator("mocap.edit_on_layer", icon="NLA")
    column.operator("mocap.push_down", icon="NLA_PUSHDOWN")
    column.operator("mocap.mark_take", icon="ASSET_MANAGER")
    column.operator("mocap.mark_pose", icon="ARMATURE_DATA")


_CLIPS = (
    *("trim_take", "loop_take", "mirror_take", "join_takes"),
    *("retime_take", "resample_take", "place_take", "root_take"),
)


@panel("Clips", "EDIT", parent="review", order=3, closed=True, needs=TAKE.is_met)
def clips(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    grid = layout.grid_flow(row_major=True, columns=1 if is_slim(context) else 2, even_columns=True, align=True)
    for name in _CLIPS:
        grid.operator(f"mocap.{name}")


def _has_sliders(context: bpy.types.Context) -> bool:
    from ...body.shape import body_mesh  # this loads NumPy, which registering must not do

    armature = context.scene.mocap.review.armature
    return armature is not None and body_mesh(armature) is not None


@panel("Body Shape", "EDIT", parent="review", order=2, closed=True, needs=_has_sliders)
def shape(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    from ...body.looks import looks_of
    from ...body.shape import body_mesh, effect_of, sliders

    mesh = body_mesh(context.scene.mocap.review.armature)
    assert mesh is not None  # guaranteed by the panel's needs
    if looks_of(mesh):
        layout.column(align=True).prop(context.scene.mocap, "look", expand=True, text_ctxt=CONTEXT)
        if context.scene.mocap.look not in looks_of(mesh):
            wrapped(
                layout, context, "This body does not contain the chosen look. Add the body again to use it.", "INFO"
            )
    else:
        wrapped(layout, context, "To change the look, use a local body from this add-on, in Object Mode.", "INFO")
    column = layout.column(align=True)
    for key in sliders(mesh):
        effect = effect_of(key)
        if is_slim(context):
            column.label(text=effect, text_ctxt=CONTEXT)
            effect = ""
        column.prop(key, "value", text=effect, text_ctxt=CONTEXT, slider=True)
    layout.operator("mocap.add_face", icon="SHAPEKEY_DATA")


def _has_limbs(context: bpy.types.Context) -> bool:
    return has_limbs(context.scene.mocap.review.armature)


@panel("FK and IK", "EDIT", parent="review", order=4, needs=_has_limbs)
def limbs(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    root = context.scene.mocap.review.armature.pose.bones[ROOT]
    column = layout.column(align=True)
    share = _NARROW_SLIDER if is_narrow(context) else _SLIDER
    for limb in LIMBS:
        row = column.split(factor=share, align=True)
        row.prop(root, f'["{limb.switch}"]', text=limb.label, text_ctxt=CONTEXT, slider=True)
        to = "FK" if root[limb.switch] > 0 else "IK"
        _draw_switch(row, to, limb.switch, to)
    row = layout.row(align=True)
    for to in ("IK", "FK"):
        _draw_switch(row, to, "ALL", f"All to {to}")
    wrapped(layout, context, "The buttons add keys that keep the motion. The sliders only blend.", "INFO")


def _draw_switch(layout: bpy.types.UILayout, to: str, limb: str, text: str) -> None:
    button = layout.operator("mocap.switch_limbs", text=text)
    button.to, button.limb = to, limb


def _has_fingers(context: bpy.types.Context) -> bool:
    return TAKE.is_met(context) or has_finger_controls(context.scene.mocap.review.armature)


@panel("Fingers", "EDIT", parent="review", order=5, closed=True, needs=_has_fingers)
def fingers(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    column = layout.column()
    column.enabled = not current.busy
    column.operator("mocap.add_gloves", icon="VIEW_PAN")
    armature = context.scene.mocap.review.armature
    if not has_finger_controls(armature):
        return
    bones = armature.pose.bones
    for side in SIDES:
        column = layout.column(align=True)
        column.label(text=f"{side.title()} Hand", text_ctxt=CONTEXT)
        rows = [("Fist", fist_control(side)), *((f.title(), finger_control(side, f)) for f in FINGERS)]
        for label, name in rows:
            row = column.row(align=True)
            row.prop(bones[name], "rotation_euler", index=_CURL, text=label, text_ctxt=CONTEXT)
            row.prop(bones[name], "rotation_euler", index=_SPREAD, text="Spread", text_ctxt=CONTEXT)
    wrapped(layout, context, "The controls add to the keys of the finger bones.", "INFO")
