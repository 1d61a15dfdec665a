"""Footage behind a camera, laid by time: Blender shows one picture a scene frame, a driver picks the right one."""

from __future__ import annotations

import math

import bpy

from ..conventions.timing import TakeTiming

FOOTAGE_RATE = "footage_fps"
"""Custom property of a camera: pictures per second of its footage."""
_LAID, _START, _OFFSET, _COUNT = "footage_scene_fps", "footage_start", "footage_offset", "footage_count"
_PATH = "background_images[0].image_user.frame_offset"


def remember_footage(camera: bpy.types.Camera, fps: float) -> None:
    """Keep what the footage behind a camera is as it was set in Blender: one picture a frame."""
    user = camera.background_images[0].image_user
    camera[FOOTAGE_RATE], camera[_START] = fps, float(user.frame_start)
    camera[_OFFSET], camera[_COUNT] = user.frame_offset, user.frame_duration


def laid_footage_rate(camera: bpy.types.Camera) -> float:
    """Return the scene rate that the footage is laid by."""
    return float(camera[_LAID])


def lay_footage(camera: bpy.types.Camera, timing: TakeTiming) -> None:
    """Show on every scene frame the picture that was taken then; none but a driver of its number is added."""
    user, count = camera.background_images[0].image_user, int(camera[_COUNT])
    rate = camera[FOOTAGE_RATE] / timing.scene_fps
    camera[_LAID] = timing.scene_fps
    camera.driver_remove(_PATH)
    user.frame_offset = camera[_OFFSET]
    user.frame_duration = 1 + math.ceil((count - 1) / rate - 1e-6)
    if abs(rate - 1) < 1e-6:
        return
    at = f"min(max(floor(frame-{timing.start:g}),0),{user.frame_duration - 1})"
    driver = camera.driver_add(_PATH).driver
    driver.type = "SCRIPTED"
    driver.expression = f"min(floor({at}*{rate:.9g}+0.5),{count - 1})-{at}+{int(camera[_OFFSET])}"
