"""Takes laid by time: at which scene rate an action's keys lie, and how they are laid anew at another."""

from __future__ import annotations

from collections.abc import Iterator

import bpy
import numpy as np

from .curves import action_curves, is_take

RATE = "scene_fps"
"""Custom property of an action: the scene's frames per second that its keys are laid by."""
_SAME = 1e-4
"""Relative difference below which two frame rates are one."""


def same_rate(a: float, b: float) -> bool:
    """Return whether two frame rates are one."""
    return abs(a - b) <= _SAME * max(a, b)


def laid_rate(action: bpy.types.Action) -> float:
    """Return the scene rate that a take's keys are laid by; takes of earlier versions show it by their length."""
    if RATE in action:
        return float(action[RATE])
    start, end = action.frame_range
    frames = int(action["frames"])
    return float(action["fps"]) * ((end - start) / (frames - 1) if frames > 1 and end > start else 1.0)


def mark_laid(action: bpy.types.Action, fps: float, frames: int, start: float, scene_fps: float) -> None:
    """Keep on an action how it is laid by time, so that it follows the scene's frame rate.

    Args:
        action: the action.
        fps: frames per second of its motion.
        frames: how many.
        start: scene frame of the first.
        scene_fps: the scene's frames per second.
    """
    action["fps"], action["frames"], action["frame_start"], action[RATE] = fps, frames, start, scene_fps


def played_takes(scene: bpy.types.Scene) -> Iterator[bpy.types.Action]:
    """Yield the takes that the objects of a scene play or have on the NLA, each once."""
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
    """Lay a take's keys, hand edits among them, by time at another scene rate; its first frame stays."""
    start, ratio = float(action["frame_start"]), scene_fps / laid_rate(action)
    for curve in action_curves(action):
        keys = curve.keyframe_points
        for name in ("co", "handle_left", "handle_right"):
            points = np.empty(2 * len(keys), np.float32)
            keys.foreach_get(name, points)
            points[::2] = start + (points[::2] - start) * ratio
            keys.foreach_set(name, points)
        curve.update()
    action[RATE] = scene_fps
    for animation in (obj.animation_data for obj in bpy.data.objects if obj.animation_data is not None):
        for strip in (strip for track in animation.nla_tracks for strip in track.strips):
            if strip.action == action:
                strip.action_frame_start, strip.action_frame_end = action.frame_range
