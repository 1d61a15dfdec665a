"""A recording of markers as a user meets it: dropped, looked at, solved, coloured, exported, at another rate."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import bpy

from tests.gui.scene import empty, extension, mocap

SOURCE = "backend/solver_backend/assets/demo_markers.c3d"
TAKE, WRITTEN = Path("/work_io/Gang ü.c3d"), Path("/work_io/gelöst.c3d")


def grades() -> set[float]:
    """Return which colours the markers have over the take."""
    return {item.value for item in mocap().capture.cloud.data.attributes["grade"].data}


def steps(user: Any) -> Any:
    """Drop, names, solve, undo, redo, colours, confidence, export, follow the frame rate."""
    package = extension()
    shutil.copy(Path(str(package.__file__)).parent / SOURCE, TAKE)
    empty()
    yield from user.open_tab("MoCap")
    with user.override:
        bpy.ops.wm.drop_import_file("INVOKE_DEFAULT", directory="/work_io/", files=[{"name": TAKE.name}])
    yield from user.until(lambda: mocap().capture.file, "the recording is read", 120)
    assert (mocap().capture.markers, mocap().capture.frames, mocap().capture.subjects) == (42, 240, "Demo")
    bpy.context.scene.frame_set(60)
    user.look_at((0.0, 0.0, 0.9), 3.2)
    yield from user.press("show_names", 0.25)
    assert mocap().capture.show_names
    yield 1.0
    yield from user.shot("markers")

    yield from user.press("mocap.solve.preset", 0.12)
    yield from user.press("mocap.solve()")
    yield 3.0
    yield from user.shot("solving")
    yield from user.until(lambda: mocap().review.armature, "the recording is solved", 600)
    assert {1.0, 2.0} <= grades()
    yield from user.key("Z", ctrl=True)
    yield 1.0
    assert mocap().review.armature is None and grades() == {0.0}, "undo"
    yield from user.key("Z", ctrl=True, shift=True)
    yield 1.0
    assert mocap().review.armature is not None and {1.0, 2.0} <= grades(), "redo"
    user.note("undone and redone in one step, colours too")
    bpy.context.scene.frame_set(60)
    yield 1.0
    yield from user.shot("solved")

    yield from user.press("show_residuals", 0.75)
    assert grades() == {0.0}
    yield from user.press("show_residuals", 0.75)
    yield from user.press("mocap.show_confidence()")
    user.look_at(mocap().review.armature.pose.bones["pelvis"].head, 2.6)
    yield 1.0
    yield from user.shot("confidence")

    yield from user.press("format='c3d', contents='solved'", 0.6)
    yield from user.shot("export")
    yield from user.accept_file(str(WRITTEN))
    yield from user.until(WRITTEN.is_file, "the solved markers are written", 120)

    bpy.context.scene.render.fps = 24
    yield 0.5
    yield from user.press("mocap.follow_rate()")
    action = mocap().review.take
    assert abs(action.frame_range[1] - (1 + 239 * 24 / 60)) < 0.1, tuple(action.frame_range)
    bpy.context.scene.frame_set(48)
    yield 1.0
    yield from user.shot("follows_24_fps")
