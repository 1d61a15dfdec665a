"""Keep an animator's actions on top of takes, and store where each take places its object."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from itertools import islice

import bpy

from ..body.controls.limbs import ROOT
from .curves import (
    action_curves,
    current_action,
    exchange_strip,
    fit_strip,
    is_take,
    play_action,
    playing_strips,
    take_strip,
)

PLACE = "place"
"""Custom property of a take: location, rotation and scale of its object and root control, unless they have keys."""
_SHOWN = "shown_take"
"""Custom property of an armature: the take that was played last. The user may have replaced it by another action."""
_PLACE_FIELDS = {
    "location": 3,
    "rotation_euler": 3,
    "rotation_quaternion": 4,
    "rotation_axis_angle": 4,
    "scale": 3,
}
LAYER_SUFFIX = " layer"
"""Suffix of the name of each action that ``add_layer`` creates."""


def has_layers(obj: bpy.types.Object) -> bool:
    """Return whether an object plays actions of the user on top of a take on the NLA."""
    strip = take_strip(obj)
    if strip is None:
        return False
    own, playing = obj.animation_data.action, playing_strips(obj)
    return (own is not None and not is_take(own)) or playing[-1] != strip


def playing_actions(obj: bpy.types.Object) -> list[bpy.types.Action]:
    """Return the actions that an object plays: its NLA strips and its assigned action."""
    own = obj.animation_data and obj.animation_data.action
    return [*(strip.action for strip in playing_strips(obj)), *([] if own is None else [own])]


def aside_note(obj: bpy.types.Object, before: list[bpy.types.Action]) -> str:
    """Return sentences about the actions in ``before`` that are now muted on the NLA."""
    tracks = obj.animation_data.nla_tracks if before else ()
    strips = [(track, strip) for track in tracks for strip in track.strips]
    where = {strip.action: track.name for track, strip in strips if strip.action is not None}
    aside = [action for action in before if action in where and action not in playing_actions(obj)]
    names = [f"{'The take' if is_take(action) else 'Your action'} '{action.name}'" for action in aside]
    notes = [f"{name} is muted on the NLA track '{where[a]}'" for name, a in zip(names, aside, strict=True)]
    return ". ".join(notes)


@contextmanager
def keep_users_action(obj: bpy.types.Object) -> Iterator[None]:
    """Keep the user's action on an object while the ``with`` block assigns another action.

    An action on top of a take remains there, and the new action replaces the take below it. Any other user action moves
    to a muted NLA track with its name and gets a fake user. Takes on the NLA are muted: a body plays only one take.
    """
    animation = obj.animation_data or obj.animation_data_create()
    _remember_place(obj)
    own, slot = animation.action, getattr(animation, "action_slot", None)
    strip, users = take_strip(obj) if has_layers(obj) else None, None if own is None or is_take(own) else own
    if users is not None:
        users.use_fake_user = True
    yield
    new = animation.action
    if new is None or new == users:
        return
    obj[_SHOWN] = new
    if strip is not None:
        exchange_strip(obj, strip, new)
        play_action(obj, own if own is None or users is not None else None, slot)
        return
    for below in playing_strips(obj):
        below.mute = below.mute or is_take(below.action)
    if users is not None:
        lay_aside(obj, users, slot)


def _remember_place(obj: bpy.types.Object) -> None:
    playing = current_action(obj)
    take = playing if playing is not None and is_take(playing) else obj.get(_SHOWN)
    if take is None or not take.is_editable:
        return
    keyed = {curve.data_path for action in playing_actions(obj) if action != take for curve in action_curves(action)}
    fields = [(owner, name) for owner in _placed(obj) for name in _PLACE_FIELDS]
    values = [[float(value) for value in getattr(owner, name)] for owner, name in fields]
    former = iter(take.get(PLACE, ()))
    known = [[float(value) for value in islice(former, len(part))] for part in values]
    for k, (owner, name) in enumerate(fields):
        if (name if owner == obj else owner.path_from_id(name)) in keyed:  # an action of the user moves it
            values[k] = known[k] or list(owner.bl_rna.properties[name].default_array)
    take[PLACE] = [value for part in values for value in part]


def restore_place(obj: bpy.types.Object, take: bpy.types.Action) -> None:
    """Restore the transforms that an object and its root control had when the take was last played."""
    values = [float(value) for value in take.get(PLACE, ())]
    if len(values) != len(_placed(obj)) * sum(_PLACE_FIELDS.values()):
        return
    for owner in _placed(obj):
        for name, width in _PLACE_FIELDS.items():
            part, values = values[:width], values[width:]
            if list(getattr(owner, name)) != part:  # because even assigning an equal value marks the object as changed
                setattr(owner, name, part)


def reset_root(obj: bpy.types.Object) -> None:
    """Reset the root control's transform, because a newly solved take has no root motion."""
    if (root := obj.pose.bones.get(ROOT)) is not None:
        root.matrix_basis.identity()


def _placed(obj: bpy.types.Object) -> list[bpy.types.Object | bpy.types.PoseBone]:
    root = obj.pose.bones.get(ROOT) if obj.type == "ARMATURE" else None
    return [obj] if root is None else [obj, root]


def lay_aside(obj: bpy.types.Object, action: bpy.types.Action, slot: object | None) -> bpy.types.NlaStrip:
    """Put an action on a new, muted NLA track with the action's name."""
    track = obj.animation_data.nla_tracks.new()
    track.name = action.name
    strip = track.strips.new(action.name, int(action.frame_range[0]), action)
    fit_strip(strip, action)
    if slot is not None:
        strip.action_slot = slot
    strip.blend_type, strip.extrapolation = "REPLACE", "NOTHING"
    track.mute = True
    return strip


def add_layer(obj: bpy.types.Object, take: bpy.types.Action) -> bpy.types.Action:
    """Move the object's current take or action to the NLA, and return a new action on top of it."""
    animation = obj.animation_data
    if (own := animation.action) is not None:
        slot, blend = getattr(animation, "action_slot", None), animation.action_blend_type
        animation.action = None
        strip = lay_aside(obj, own, slot)
        strip.blend_type, strip.extrapolation = "REPLACE" if own == take else blend, "HOLD"
        animation.nla_tracks[-1].mute = False
    layer = bpy.data.actions.new(f"{take.name}{LAYER_SUFFIX}")
    layer.use_fake_user = True
    animation.action = layer
    if hasattr(layer, "slots"):
        animation.action_slot = layer.slots.new(id_type="OBJECT", name=obj.name)
    animation.action_blend_type = "COMBINE"
    return layer


@contextmanager
def without_layers(obj: bpy.types.Object) -> Iterator[None]:
    """Mute the user's layers on top of a take during the ``with`` block."""
    animation, strip = obj.animation_data, take_strip(obj)
    if animation is None or strip is None or not has_layers(obj):
        yield
        return
    tracks = list(animation.nla_tracks)
    base = next(k for k, track in enumerate(tracks) if strip in list(track.strips))
    muted = [track for track in tracks[base + 1 :] if not track.mute]
    influence = animation.action_influence
    try:
        animation.action_influence = 0.0
        for track in muted:
            track.mute = True
        yield
    finally:
        animation.action_influence = influence
        for track in muted:
            track.mute = False
