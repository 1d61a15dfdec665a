"""Whole animation curves, written at once, in the layout of each Blender version."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np


@dataclass(frozen=True)
class CurveTarget:
    """An action bound to an object, and where its curves go."""

    action: bpy.types.Action
    """The new action."""
    container: Any
    """The slot's channelbag (Blender 4.4 and later) or the action itself."""


def create_action(name: str, obj: bpy.types.Object) -> CurveTarget:
    """Create an action with a slot for one object and make it the object's current one; older actions stay."""
    action = bpy.data.actions.new(name)
    if hasattr(action, "slots"):
        action.slots.new(id_type="OBJECT", name=obj.name)
    play_action(obj, action)
    target = curve_target(action)
    assert target is not None, "the action has a slot"
    return target


def is_take(action: bpy.types.Action) -> bool:
    """Return whether an action was laid by ``bake_action``."""
    return all(key in action for key in ("fps", "frames", "frame_start"))


def playing_strips(obj: bpy.types.Object) -> list[bpy.types.NlaStrip]:
    """Return the NLA strips of an object that are not muted, the lowest first."""
    animation = obj.animation_data
    if animation is None:
        return []
    tracks = [track for track in animation.nla_tracks if not track.mute]
    return [strip for track in tracks for strip in track.strips if not strip.mute and strip.action is not None]


def take_strip(obj: bpy.types.Object) -> bpy.types.NlaStrip | None:
    """Return the highest playing NLA strip of a take."""
    return next((strip for strip in reversed(playing_strips(obj)) if is_take(strip.action)), None)


def current_action(obj: bpy.types.Object) -> bpy.types.Action | None:
    """Return the take that an object plays, also below layers of the user's; without a take the topmost action."""
    own, playing = obj.animation_data and obj.animation_data.action, playing_strips(obj)
    if own is not None and is_take(own):
        return own
    if (strip := take_strip(obj)) is not None:
        return strip.action
    return own or (playing[-1].action if playing else None)


def play_action(obj: bpy.types.Object, action: bpy.types.Action | None, slot: Any = None) -> None:
    """Make an action an object's own, with its slot where there are slots."""
    animation = obj.animation_data or obj.animation_data_create()
    animation.action = action
    if action is not None and hasattr(action, "slots") and len(action.slots):
        animation.action_slot = slot or action.slots[0]


def exchange_strip(obj: bpy.types.Object, strip: bpy.types.NlaStrip, action: bpy.types.Action) -> None:
    """Put a whole action in the place of an NLA strip, on the frames where its keys are."""
    [track] = [track for track in obj.animation_data.nla_tracks if strip in list(track.strips)]
    kept = {name: getattr(strip, name) for name in ("blend_type", "extrapolation", "use_auto_blend")}
    track.strips.remove(strip)
    new = track.strips.new(action.name, int(action.frame_range[0]), action)
    fit_strip(new, action)
    for name, value in kept.items():
        setattr(new, name, value)


def fit_strip(strip: bpy.types.NlaStrip, action: bpy.types.Action) -> None:
    """Let a new NLA strip play a whole action, on the frames where its keys are."""
    if hasattr(action, "slots") and len(action.slots):
        strip.action_slot = action.slots[0]
    strip.action_frame_start, strip.action_frame_end = action.frame_range
    strip.frame_start_ui, strip.frame_end_ui = action.frame_range


def action_curves(action: bpy.types.Action) -> Iterator[bpy.types.FCurve]:
    """Yield the curves of an action in any Blender version."""
    if not hasattr(action, "slots"):
        yield from action.fcurves
        return
    for layer in action.layers:
        for strip in layer.strips:
            for bag in strip.channelbags:
                yield from bag.fcurves


def played_target(obj: bpy.types.Object) -> CurveTarget | None:
    """Return where the curves of an object's own action go; None if it has none, or cannot change it."""
    action = current_action(obj)
    if action is None or not action.is_editable or action != obj.animation_data.action:
        return None
    return curve_target(action, obj.animation_data.action_slot if hasattr(action, "slots") else None)


def curve_target(action: bpy.types.Action, slot: Any = None) -> CurveTarget | None:
    """Return where the curves of an action go; None where it has no slot."""
    if not hasattr(action, "slots"):
        return CurveTarget(action, action)
    slot = slot or next(iter(action.slots), None)
    if slot is None:
        return None
    layer = action.layers[0] if action.layers else action.layers.new("Layer")
    strip = layer.strips[0] if layer.strips else layer.strips.new(type="KEYFRAME")
    return CurveTarget(action, strip.channelbag(slot, ensure=True))


def remove_curves(target: CurveTarget, path: str) -> np.ndarray | None:
    """Remove a property's curves; return the (F, 2) times and key types of the first, None where there was none."""
    curves = [curve for curve in target.container.fcurves if curve.data_path == path]
    if not curves:
        return None
    keys = curves[0].keyframe_points
    points, types = np.empty(2 * len(keys), np.float32), np.empty(len(keys), np.int32)
    keys.foreach_get("co", points)
    keys.foreach_get("type", types)
    for curve in curves:
        target.container.fcurves.remove(curve)
    return np.stack([points[::2], types], axis=1)


def write_curves(
    target: CurveTarget, path: str, group: str, times: np.ndarray, values: np.ndarray, types: np.ndarray
) -> None:
    """Write one curve a column, LINEAR between its keys.

    Args:
        target: from ``create_action``.
        path: data path of the property.
        group: channel group, one a bone.
        times: (F,) scene frames, rising; they need not be whole.
        values: (F, N) one column for each index of the property.
        types: (F,) key types, see ``key_type_values``.
    """
    linear = np.full(len(times), _enum_value("interpolation", "LINEAR"), dtype=np.int32)
    for curve, column in zip(_new_curves(target, path, group, values.shape[1]), values.T, strict=True):
        curve.keyframe_points.add(len(times))
        curve.keyframe_points.foreach_set("co", _points(times, column))
        curve.keyframe_points.foreach_set("interpolation", linear)
        curve.keyframe_points.foreach_set("type", types)
        curve.update()


def write_smooth_curves(
    target: CurveTarget, path: str, group: str, times: np.ndarray, values: np.ndarray, slopes: np.ndarray
) -> None:
    """Write one Bezier curve a column, which is the cubic through its keys with the given slopes.

    Handles a third of the interval to the next key make a Bezier piece a cubic polynomial of time.

    Args:
        target: from ``create_action``.
        path: data path of the property.
        group: channel group, one a bone.
        times: (K,) scene frames, rising.
        values: (K, N) one column for each index of the property.
        slopes: (K, N) per scene frame.
    """
    bezier = np.full(len(times), _enum_value("interpolation", "BEZIER"), dtype=np.int32)
    aligned = np.full(len(times), _enum_value("handle_left_type", "ALIGNED"), dtype=np.int32)
    steps = np.diff(times, prepend=times[0] - 1, append=times[-1] + 1) / 3
    curves = _new_curves(target, path, group, values.shape[1])
    for curve, column, slope in zip(curves, values.T, slopes.T, strict=True):
        keys = curve.keyframe_points
        keys.add(len(times))
        keys.foreach_set("co", _points(times, column))
        keys.foreach_set("interpolation", bezier)
        keys.foreach_set("handle_left_type", aligned)
        keys.foreach_set("handle_right_type", aligned)
        keys.foreach_set("handle_left", _points(times - steps[:-1], column - slope * steps[:-1]))
        keys.foreach_set("handle_right", _points(times + steps[1:], column + slope * steps[1:]))
        keys.foreach_set("type", key_type_values(None, len(times)))
        curve.update()


def key_type_values(keyframes: np.ndarray | None, frames: int) -> np.ndarray:
    """Return the (F,) key types: KEYFRAME at the solver's keyframes, GENERATED between (BREAKDOWN before Blender 4.3).

    Without keyframes every key is a KEYFRAME.
    """
    keyframe = _enum_value("type", "KEYFRAME")
    if keyframes is None:
        return np.full(frames, keyframe, dtype=np.int32)
    between = _enum_value("type", "GENERATED", "BREAKDOWN")
    return np.where(keyframes, keyframe, between).astype(np.int32)


def _new_curves(target: CurveTarget, path: str, group: str, count: int) -> list[bpy.types.FCurve]:
    groups = target.container.groups
    channels = groups[group] if group in groups else groups.new(group)
    curves = [target.container.fcurves.new(path, index=index) for index in range(count)]
    for curve in curves:
        curve.group = channels
    return curves


def _points(times: np.ndarray, values: np.ndarray) -> np.ndarray:
    return np.stack([times, values], axis=1).astype(np.float32).ravel()


def _enum_value(prop: str, *names: str) -> int:
    """Return the number ``foreach_set`` wants for the first name this Blender knows."""
    items = bpy.types.Keyframe.bl_rna.properties[prop].enum_items
    return next(items[name].value for name in names if name in items)
