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
    animation = obj.animation_data or obj.animation_data_create()
    if not hasattr(action, "slots"):
        animation.action = action
        return CurveTarget(action, action)
    slot = action.slots.new(id_type="OBJECT", name=obj.name)
    strip = action.layers.new("Layer").strips.new(type="KEYFRAME")
    animation.action = action
    animation.action_slot = slot
    return CurveTarget(action, strip.channelbag(slot, ensure=True))


def action_curves(action: bpy.types.Action) -> Iterator[bpy.types.FCurve]:
    """Yield the curves of an action in any Blender version."""
    if not hasattr(action, "slots"):
        yield from action.fcurves
        return
    for layer in action.layers:
        for strip in layer.strips:
            for bag in strip.channelbags:
                yield from bag.fcurves


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
    channels = (
        target.container.groups.new(group) if group not in target.container.groups else target.container.groups[group]
    )
    linear = np.full(len(times), _enum_value("interpolation", "LINEAR"), dtype=np.int32)
    points = np.empty((len(times), 2), dtype=np.float32)
    points[:, 0] = times
    for index in range(values.shape[1]):
        curve = target.container.fcurves.new(path, index=index)
        curve.group = channels
        curve.keyframe_points.add(len(times))
        points[:, 1] = values[:, index]
        curve.keyframe_points.foreach_set("co", points.ravel())
        curve.keyframe_points.foreach_set("interpolation", linear)
        curve.keyframe_points.foreach_set("type", types)
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


def _enum_value(prop: str, *names: str) -> int:
    """Return the number ``foreach_set`` wants for the first name this Blender knows."""
    items = bpy.types.Keyframe.bl_rna.properties[prop].enum_items
    return next(items[name].value for name in names if name in items)
