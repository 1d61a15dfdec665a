"""Adapt takes, detections and footage to the scene's frame rate."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from math import ceil

import bpy

from ..animation.curves import RATE, laid_rate, played_takes, relay_take, same_rate
from ..conventions.timing import TakeTiming, scene_frame_rate
from .cameras import FOOTAGE_RATE, laid_footage_rate, lay_footage
from .point_player import last_row_frame, played_rate, player_of, set_played_rate

_AT_THE_END = 1.0
"""Tolerance in scene frames between the end of the scene's range and the end of its contents, which is rounded up."""


def needs_relaying(scene: bpy.types.Scene, takes: Iterable[bpy.types.Action] = ()) -> bool:
    """Return whether a scene's contents were placed for a different frame rate."""
    rate = scene_frame_rate(scene)
    laid = [
        *(laid_rate(action) for action in (*played_takes(scene), *takes)),
        *(obj["fps"] / played_rate(obj) for obj in _overlays(scene)),
        *(laid_footage_rate(obj.data) for obj in _filmed(scene)),
    ]
    return not all(same_rate(one, rate) for one in laid)


def relay(scene: bpy.types.Scene, takes: Iterable[bpy.types.Action] = ()) -> float:
    """Adapt a scene's contents to its frame rate, and return the ratio of new to old durations in frames."""
    rate = scene_frame_rate(scene)
    actions = list({action.name_full: action for action in (*played_takes(scene), *takes)}.values())
    overlays = list(_overlays(scene))
    laid = [*map(laid_rate, actions), *(obj["fps"] / played_rate(obj) for obj in overlays)]
    ratio = next((rate / one for one in laid if not same_rate(one, rate)), 1.0)
    ends = [action.frame_range[1] for action in actions] + [last_row_frame(obj) for obj in overlays]
    if ends and abs(scene.frame_end - max(ends)) <= _AT_THE_END:
        first = scene.frame_start
        scene.frame_end = max(first, ceil(first + (scene.frame_end - first) * ratio - 1e-3))
    for action in actions:
        if not same_rate(laid_rate(action), rate):
            relay_take(action, rate)
        action[RATE] = rate
    for obj in overlays:
        set_played_rate(obj, obj["fps"] / rate)
    for obj in _filmed(scene):
        lay_footage(obj.data, TakeTiming(obj.data["footage_start"], rate))
    return ratio


def _overlays(scene: bpy.types.Scene) -> Iterator[bpy.types.Object]:
    return (obj for obj in scene.objects if "fps" in obj and player_of(obj) is not None)


def _filmed(scene: bpy.types.Scene) -> Iterator[bpy.types.Object]:
    return (obj for obj in scene.objects if obj.type == "CAMERA" and FOOTAGE_RATE in obj.data)
