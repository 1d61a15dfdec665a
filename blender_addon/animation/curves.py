"""Read and write whole animation curves in any supported Blender version."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np


@dataclass(frozen=True)
class CurveTarget:
    """The container of an action's animation curves for one object."""

    action: bpy.types.Action
    container: Any  # The slot's channelbag (Blender 4.4 and later), or the action itself.


def create_action(name: str, obj: Any) -> CurveTarget:
    """Create an action with a slot for an object or its shape keys, and play it."""
    action = bpy.data.actions.new(name)
    if hasattr(action, "slots"):
        action.slots.new(id_type=obj.id_type, name=obj.name)
    play_action(obj, action)
    target = curve_target(action)
    assert target is not None, "the action has a slot"
    return target


def is_take(action: bpy.types.Action) -> bool:
    """Return whether an action is a take written by ``bake_action``."""
    return all(key in action for key in ("fps", "frames", "frame_start"))


def playing_strips(obj: bpy.types.Object) -> list[bpy.types.NlaStrip]:
    """Return an object's unmuted NLA strips from bottom to top."""
    animation = obj.animation_data
    if animation is None:
        return []
    tracks = [track for track in animation.nla_tracks if not track.mute]
    return [strip for track in tracks for strip in track.strips if not strip.mute and strip.action is not None]


def take_strip(obj: bpy.types.Object) -> bpy.types.NlaStrip | None:
    """Return the topmost unmuted NLA strip that plays a take."""
    return next((strip for strip in reversed(playing_strips(obj)) if is_take(strip.action)), None)


def current_action(obj: bpy.types.Object) -> bpy.types.Action | None:
    """Return the take that an object plays, or else its assigned action or its topmost NLA strip's action."""
    own, playing = obj.animation_data and obj.animation_data.action, playing_strips(obj)
    if own is not None and is_take(own):
        return own
    if (strip := take_strip(obj)) is not None:
        return strip.action
    return own or (playing[-1].action if playing else None)


def play_action(obj: Any, action: bpy.types.Action | None, slot: Any = None) -> None:
    """Assign an action to an object. In Blender versions that have slots, assign its slot too."""
    animation = obj.animation_data or obj.animation_data_create()
    animation.action = action
    if action is not None and hasattr(action, "slots") and len(action.slots):
        animation.action_slot = slot or action.slots[0]


def exchange_strip(obj: bpy.types.Object, strip: bpy.types.NlaStrip, action: bpy.types.Action) -> None:
    """Replace an NLA strip by a strip that plays all of ``action``, at the scene frames of the action's keys."""
    [track] = [track for track in obj.animation_data.nla_tracks if strip in list(track.strips)]
    kept = {name: getattr(strip, name) for name in ("blend_type", "extrapolation", "use_auto_blend")}
    track.strips.remove(strip)
    new = track.strips.new(action.name, int(action.frame_range[0]), action)
    fit_strip(new, action)
    for name, value in kept.items():
        setattr(new, name, value)


def fit_strip(strip: bpy.types.NlaStrip, action: bpy.types.Action) -> None:
    """Make an NLA strip play all of ``action``, at the scene frames of the action's keys."""
    if hasattr(action, "slots") and len(action.slots):
        strip.action_slot = action.slots[0]
    strip.action_frame_start, strip.action_frame_end = action.frame_range
    strip.frame_start_ui, strip.frame_end_ui = action.frame_range


def action_curves(action: bpy.types.Action) -> Iterator[bpy.types.FCurve]:
    """Yield all animation curves of an action, in any Blender version."""
    if not hasattr(action, "slots"):
        yield from action.fcurves
        return
    for layer in action.layers:
        for strip in layer.strips:
            for bag in strip.channelbags:
                yield from bag.fcurves


def played_target(obj: bpy.types.Object) -> CurveTarget | None:
    """Return the curves of the action assigned to an object, or None if there is no editable action."""
    action = current_action(obj)
    if action is None or not action.is_editable or action != obj.animation_data.action:
        return None
    return curve_target(action, obj.animation_data.action_slot if hasattr(action, "slots") else None)


def curve_target(action: bpy.types.Action, slot: Any = None) -> CurveTarget | None:
    """Return the curves of an action, or None if the action has no slot."""
    if not hasattr(action, "slots"):
        return CurveTarget(action, action)
    slot = slot or next(iter(action.slots), None)
    if slot is None:
        return None
    layer = action.layers[0] if action.layers else action.layers.new("Layer")
    strip = layer.strips[0] if layer.strips else layer.strips.new(type="KEYFRAME")
    return CurveTarget(action, strip.channelbag(slot, ensure=True))


def remove_curves(target: CurveTarget, path: str) -> np.ndarray | None:
    """Remove a property's curves. Return times and types (K, 2) of the first curve's keys, or None without curves."""
    curves = [curve for curve in target.container.fcurves if curve.data_path == path]
    if not curves:
        return None
    keys = curves[0].keyframe_points
    types = np.empty(len(keys), np.int32)
    keys.foreach_get("type", types)
    found = np.stack([key_points(curves[0])[:, 0], types], axis=1)
    for curve in curves:
        target.container.fcurves.remove(curve)
    return found


def key_points(curve: bpy.types.FCurve, field: str = "co") -> np.ndarray:
    """Return (K, 2) scene frames and values of a curve's keys, or of the keys' left or right handles."""
    points = np.empty(2 * len(curve.keyframe_points), np.float32)
    curve.keyframe_points.foreach_get(field, points)
    return points.reshape(-1, 2)


def curve_values(curve: bpy.types.FCurve, times: np.ndarray) -> np.ndarray:
    """Evaluate a curve at (F,) ascending scene frames, directly from its keys if possible."""
    points = key_points(curve)
    if len(points) == len(times) and np.array_equal(points[:, 0], times.astype(np.float32)) and not curve.modifiers:
        return points[:, 1].astype(np.float64)
    return np.array([curve.evaluate(time) for time in times])


def keys_of(action: bpy.types.Action, *but: str) -> dict[tuple[str, int], tuple[Any, ...]]:
    """Return an action's keys and modifiers in a form that can be compared with ``==``.

    Curves with a data path that ends in any of ``but`` are skipped.
    """
    curves = (curve for curve in action_curves(action) if not curve.data_path.endswith(but))
    return {(curve.data_path, curve.array_index): _motion_of(curve) for curve in curves}


_EASES = ("interpolation", "easing")
_DRAWN = {"name", "active", "show_expanded"}  # Properties of a modifier that do not affect its result.


def _motion_of(curve: bpy.types.FCurve) -> tuple[Any, ...]:
    eases = np.empty((len(_EASES), len(curve.keyframe_points)), np.int32)
    for name, column in zip(_EASES, eases, strict=True):
        curve.keyframe_points.foreach_get(name, column)
    has_handles = _enum_value("interpolation", "BEZIER") in eases[0]
    fields = ("co", "handle_left", "handle_right") if has_handles else ("co",)
    points = [key_points(curve, field).tobytes() for field in fields]
    modifiers = [_settings(modifier) for modifier in curve.modifiers]
    return eases.tobytes(), points, curve.mute, curve.extrapolation, modifiers


def _settings(item: Any) -> dict[str, Any]:
    """Return the property values of a Blender item, including arrays and nested items."""
    found: dict[str, Any] = {}
    for prop in item.bl_rna.properties:
        if prop.type == "COLLECTION":
            found[prop.identifier] = [_settings(part) for part in getattr(item, prop.identifier)]
        elif prop.type != "POINTER" and prop.identifier not in _DRAWN:
            value = getattr(item, prop.identifier)
            found[prop.identifier] = tuple(value) if getattr(prop, "is_array", False) else value
    return found


def write_curves(
    target: CurveTarget,
    path: str,
    group: str,
    times: np.ndarray,
    values: np.ndarray,
    types: np.ndarray,
    slopes: np.ndarray | None = None,
) -> None:
    """Write one animation curve per column of values, with linear or cubic segments.

    The Bezier handles of cubic segments span a third of the interval, so that values are cubic polynomials of time.

    Args:
        times: (F,) scene frames in ascending order, not necessarily whole.
        values: (F, N) values, one column per index of the property.
        types: (F,) key types (see ``key_type_values``).
        slopes: (F, N) change of the values per scene frame, or None for linear segments.
    """
    columns = {"interpolation": ("LINEAR",)}
    if slopes is not None:
        columns = {"interpolation": ("BEZIER",), "handle_left_type": ("ALIGNED",), "handle_right_type": ("ALIGNED",)}
    fields = {name: np.full(len(times), _enum_value(name, *value), np.int32) for name, value in columns.items()}
    for k, curve in enumerate(_new_curves(target, path, group, values.shape[1])):
        keys, column = curve.keyframe_points, values[:, k]
        keys.add(len(times))
        keys.foreach_set("co", _points(times, column))
        for name, field in fields.items():
            keys.foreach_set(name, field)
        if slopes is not None:
            steps = np.diff(times, prepend=times[0] - 1, append=times[-1] + 1) / 3
            keys.foreach_set("handle_left", _points(times - steps[:-1], column - slopes[:, k] * steps[:-1]))
            keys.foreach_set("handle_right", _points(times + steps[1:], column + slopes[:, k] * steps[1:]))
        keys.foreach_set("type", types)
        curve.update()


def key_type_values(keyframes: np.ndarray | None, frames: int) -> np.ndarray:
    """Return (F,) key types: KEYFRAME at the solver's keyframes and GENERATED in all other frames."""
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
    """Return the number of a keyframe property's enum item: the first of ``names`` that this Blender version has."""
    items = bpy.types.Keyframe.bl_rna.properties[prop].enum_items
    return next(items[name].value for name in names if name in items)


RATE = "scene_fps"  # Custom property of an action: the scene frame rate at which its keys were placed.
_SAME = 1e-4  # Frame rates are equal if they differ by less than this fraction.


def same_rate(a: float, b: float) -> bool:
    """Return whether two frame rates are equal, within 0.01 %."""
    return abs(a - b) <= _SAME * max(a, b)


def laid_rate(action: bpy.types.Action) -> float:
    """Return the scene frame rate that a take's keys were placed for."""
    return float(action[RATE])


def mark_laid(action: bpy.types.Action, fps: float, frames: int, start: float, scene_fps: float) -> None:
    """Store a take's timing in its action. ``relay_take`` uses it to adapt the take to another scene frame rate."""
    action["fps"], action["frames"], action["frame_start"], action[RATE] = fps, frames, start, scene_fps


def played_takes(scene: bpy.types.Scene) -> Iterator[bpy.types.Action]:
    """Yield each take that an armature in the scene plays or has on the NLA, without duplicates."""
    seen: set[str] = set()
    for obj in scene.objects:
        animation = obj.animation_data if obj.type == "ARMATURE" else None
        if animation is None:
            continue
        strips = [strip.action for track in animation.nla_tracks for strip in track.strips]
        for action in (animation.action, *strips):
            if action is not None and is_take(action) and action.name_full not in seen:
                seen.add(action.name_full)
                yield action


def relay_take(action: bpy.types.Action, scene_fps: float) -> None:
    """Adapt a take's keys and hand edits to another scene frame rate."""
    start, ratio = float(action["frame_start"]), scene_fps / laid_rate(action)
    for curve in action_curves(action):
        for name in ("co", "handle_left", "handle_right"):
            points = key_points(curve, name)
            points[:, 0] = start + (points[:, 0] - start) * ratio
            curve.keyframe_points.foreach_set(name, points.ravel())
        curve.update()
    action[RATE] = scene_fps
    for animation in (obj.animation_data for obj in bpy.data.objects if obj.animation_data is not None):
        for strip in (strip for track in animation.nla_tracks for strip in track.strips):
            if strip.action == action:
                strip.action_frame_start, strip.action_frame_end = action.frame_range
