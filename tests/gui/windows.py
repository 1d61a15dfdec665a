"""Two Blender windows, by clicks: a solve started in either, another scene beside it, and a window that is closed.

``python -m tests.gui --script windows.py``: on the demo capture.
"""

from __future__ import annotations

from typing import Any

import bpy

from tests.gui.scene import empty, extension, mocap


def steps(user: Any) -> Any:
    """Play it."""
    empty()
    yield from user.open_tab("MoCap")
    yield from user.press("mocap.demo_capture(kind='CAMERAS')", 0.25)
    yield from user.until(lambda: mocap().capture.file, "the demo capture is there", 300)
    mocap().solve.preset, mocap().solve.report = "FAST", False
    with user.override:
        bpy.ops.wm.window_new_main()
    yield 1.5
    assert len(bpy.context.window_manager.windows) == 2
    user.which = 1
    yield from user.open_tab("MoCap")
    yield from user.shot("two_windows")
    yield from another_scene(user)
    yield from closed(user)


def another_scene(user: Any) -> Any:
    """Solve from the second window; its scene is changed meanwhile: the take arrives in the scene that it is of."""
    scene, other = bpy.context.scene, bpy.data.scenes.new("Other")
    yield from user.press("mocap.solve()")
    yield from user.until(busy, "it is at work", 20)
    user.window.scene = other
    yield from user.until(lambda: not busy(), "it is solved", 600)
    yield 1.0
    assert user.window.scene == other, "the window shows what it showed"
    assert scene.mocap.review.take is not None and other.mocap.review.take is None
    assert scene.mocap.review.armature.name in scene.objects and not other.objects
    user.note("the take arrived in the scene that it is of")
    user.window.scene = scene
    yield 0.5
    yield from user.shot("solved")


def closed(user: Any) -> Any:
    """Close the window in which a solve was started: the other one shows that it ended, and solves again."""
    takes = len(bpy.data.actions)
    mocap().stage = "SOLVE"  # stages are clicked by the other scripts; here windows are the subject
    yield 0.5
    yield from user.press("mocap.solve()")
    yield from user.until(busy, "it is at work", 20)
    with bpy.context.temp_override(window=user.window):
        bpy.ops.wm.window_close()
    user.which = 0
    yield 1.0
    last = extension("ui.operators.base").current.last
    assert not busy() and last.error["code"] == "window_closed" and len(bpy.data.actions) == takes
    yield from user.shot("window_closed")
    yield from user.press("mocap.dismiss()")
    mocap().stage = "SOLVE"  # stages are clicked by the other scripts; here windows are the subject
    yield 0.5
    yield from user.press("mocap.solve()")
    yield from user.until(busy, "it is at work", 20)
    yield from user.until(lambda: not busy(), "it is solved from the first window", 600)
    yield 1.0
    assert len(bpy.data.actions) == takes + 1


def busy() -> bool:
    """Return whether a run is under way."""
    return bool(extension("ui.operators.base").current.busy)
