"""The pictures of ``docs/tutorials``, taken with the demo capture: ``python -m tests.gui --script pictures.py``."""

from __future__ import annotations

from typing import Any

import bpy

_SHOWN_FRAME = 200
_SETTLED_S = 3.0
"""A screen without a graphics card needs a while."""


def steps(user: Any) -> Any:
    """Start, look through a camera, solve, review."""
    for obj in list(bpy.data.objects):
        bpy.data.objects.remove(obj)
    yield from user.open_tab("MoCap")
    yield from user.shot("start")
    yield from user.press("mocap.demo_capture(kind='CAMERAS')", 0.25)
    yield from user.until(lambda: bpy.context.scene.mocap.capture.file, "the demo capture is there", 300)
    bpy.context.scene.frame_set(_SHOWN_FRAME)
    yield from user.press("mocap.view_camera(index=1)", 0.3)
    yield _SETTLED_S
    yield from user.shot("camera")
    yield from user.press("mocap.leave_camera()")
    yield from user.press("mocap.solve()")
    yield 2 * _SETTLED_S
    yield from user.shot("solving")
    yield from user.until(lambda: bpy.context.scene.mocap.review.armature, "the capture is solved", 900)
    bpy.context.scene.frame_set(_SHOWN_FRAME)
    yield from user.press("mocap.show_confidence()")
    user.look_at(bpy.context.scene.mocap.review.armature.pose.bones["pelvis"].head, 3.4)
    yield _SETTLED_S
    yield from user.shot("review")
