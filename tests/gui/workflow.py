"""The whole workflow as a user goes through it, from a dropped file to an exported body."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy

from tests.gui.scene import TRIAL, empty, mocap


def steps(user: Any) -> Any:
    """Drop, look, solve, cancel, solve again, undo, redo, review, pin, export, solve a range again."""
    empty()
    yield from user.open_tab("MoCap")
    yield from user.narrow(330)  # presets are buttons in a row
    yield from user.shot("empty")

    bpy.ops.preferences.addon_show(module="bl_ext.user_default.manifold_mocap")
    yield 1.0
    bpy.ops.mocap.test_python()
    yield from user.shot("preferences")
    with bpy.context.temp_override(window=bpy.context.window_manager.windows[-1]):
        bpy.ops.wm.window_close()
    yield 0.5

    with user.override:
        files = [{"name": "Config.toml"}]
        bpy.ops.wm.drop_import_file("INVOKE_DEFAULT", directory=str(TRIAL), files=files)
    yield from user.until(lambda: mocap().capture.file, "the capture is read", 120)
    assert len(mocap().capture.cameras) == 4 and mocap().capture.frames == 100
    yield from user.shot("capture")
    yield from user.press("mocap.view_camera(index=2)", 0.3)
    assert bpy.context.scene.camera == mocap().capture.cameras[2].object
    yield from user.shot("camera")

    yield from user.press("mocap.solve.preset", 0.92)
    assert mocap().solve.preset == "CUSTOM"
    settings = mocap().solve  # slow enough to be cancelled
    settings.method, settings.iterations, settings.robust_scale = "frame", 200, 0.1
    yield from user.press("mocap.solve()")
    yield 2.0
    yield from user.shot("solving")
    yield from user.key("ESC")
    yield 0.5
    yield from user.press("mocap.cancel()")
    yield 1.0
    yield from user.until(lambda: not bpy.ops.mocap.cancel.poll(), "the solve is cancelled", 30)
    assert mocap().review.armature is None
    yield from user.shot("cancelled")

    yield from user.press("mocap.solve.preset", 0.12)
    assert mocap().solve.preset == "FAST"
    yield from user.press("mocap.solve()")
    yield from user.until(lambda: mocap().review.armature, "the capture is solved", 600)
    yield from user.shot("solved")
    first = mocap().review.armature.animation_data.action
    name = first.name
    assert first.use_fake_user and first["motion_file"]

    yield from user.key("Z", ctrl=True)
    yield 1.0
    assert mocap().review.armature is None and name not in bpy.data.actions, "undo"
    user.note("undone in one step")
    yield from user.key("Z", ctrl=True, shift=True)
    yield 1.0
    assert mocap().review.armature is not None and name in bpy.data.actions, "redo"
    user.note("redone in one step")

    yield from user.press("mocap.view_camera(index=2)", 0.3)
    yield from user.shot("overlay")
    yield from user.press("mocap.leave_camera()")
    yield from user.press("mocap.show_confidence()")
    assert bpy.context.mode == "OBJECT" and mocap().review.colours
    user.look_at(mocap().review.armature.pose.bones["pelvis"].head, 3.2)
    yield from user.shot("confidence")

    mocap().review.below = 0.65
    yield from user.press("mocap.next_bad_range(backwards=False)", 0.75)
    frame = bpy.context.scene.frame_current
    assert mocap().review.first <= frame <= mocap().review.last
    yield from user.press("mocap.pin_pose()")
    assert [pin.frame for pin in mocap().review.pins] == [frame]
    yield from user.shot("pinned")

    yield from user.press('node="Armature"', 0.25)
    yield from user.shot("export")
    yield from user.accept_file("/work_io/body ü.fbx")
    yield from user.until(lambda: Path("/work_io/body ü.fbx").is_file(), "the body is exported", 120)

    takes = len(bpy.data.actions)
    yield from user.press("mocap.resolve_range()")
    yield from user.until(lambda: not bpy.ops.mocap.cancel.poll(), "the range is solved again", 600)
    assert len(bpy.data.actions) == takes + 1
    yield 2.0
    yield from user.shot("solved_again")

    yield from user.press("mocap.solve.preset", 0.92)
    yield from user.press("mocap.solve()")
    yield 1.5
    assert bpy.ops.mocap.cancel.poll()
    user.note("Blender is closed during a solve")
