"""A shot of the user's: solved unsaved, saved late, saved as another file, moved; a second capture; another rate.

``python -m tests.gui --script project.py``: in the factory scene, cube and all.
"""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import bpy

from tests.gui.scene import extension, file_of, mocap

FIRST, COPY, MOVED = (Path("/work_io", name) for name in ("Schuss ü", "Kopie", "Umzug ü"))
MARKERS = Path("/work_io/Gang ü.c3d")


def users_state() -> tuple[Any, ...]:
    """Return what a solve that arrives must leave alone."""
    scene, active = bpy.context.scene, bpy.context.view_layer.objects.active
    selected = tuple(sorted(obj.name for obj in bpy.context.view_layer.objects if obj.select_get()))
    rate = scene.render.fps, scene.frame_start, scene.frame_end, scene.frame_current
    return (active.name, active.mode, selected, *rate, scene.camera.name, scene.render.resolution_x)


def assert_beside(folder: Path) -> None:
    """Check that the take's files lie beside the .blend file and are linked relative to it."""
    for key in ("motion_file", "capture_file", "job_file", "report_file"):
        assert mocap().review.take[key].startswith("//mocap/"), mocap().review.take[key]
        assert file_of(key).is_file() and file_of(key).is_relative_to(folder / "mocap"), file_of(key)


def steps(user: Any) -> Any:
    """Play it."""
    assert "Cube" in bpy.data.objects
    yield from user.open_tab("MoCap")
    yield from user.press("mocap.demo_capture(kind='CAMERAS')", 0.25)
    yield from user.until(lambda: mocap().capture.file, "the demo capture is there", 300)
    mocap().solve.preset = "FAST"
    yield from while_editing(user)
    yield from saved_late(user)
    yield from moved(user)
    yield from second_capture(user)
    yield from other_rate(user)


def while_editing(user: Any) -> Any:
    """Solve while the cube is edited: mode, frame, selection and set-up stay."""
    cube = bpy.data.objects["Cube"]
    bpy.context.view_layer.objects.active = cube
    for obj in bpy.context.view_layer.objects:
        obj.select_set(obj == cube)
    bpy.context.scene.frame_set(17)
    yield from user.key("TAB")
    assert cube.mode == "EDIT"
    before = users_state()
    yield from user.press("mocap.solve()")
    yield from user.until(lambda: any("motion_file" in action for action in bpy.data.actions), "it is solved", 900)
    yield 1.0
    assert users_state() == before, (users_state(), before)
    user.note("the solve that arrived left Edit Mode, frame, selection and set-up alone")
    yield from user.shot("arrived_while_editing")
    yield from user.key("TAB")
    assert cube.mode == "OBJECT"
    motion = file_of("motion_file")
    assert "unsaved " in str(motion) and not motion.is_relative_to(bpy.utils.user_resource("EXTENSIONS")), motion
    yield from user.find("mocap.solve()")
    yield from user.shot("unsaved_says_where_takes_wait")


def saved_late(user: Any) -> Any:
    """Save by Ctrl S, then as another file elsewhere."""
    session = file_of("motion_file").parent
    for folder in (FIRST, COPY):
        folder.mkdir()
    yield from user.key("S", ctrl=True)
    yield from user.accept_file(str(FIRST / "a.blend"))
    yield from user.until(lambda: bpy.data.filepath == str(FIRST / "a.blend"), "the file is saved", 60)
    assert_beside(FIRST)
    assert not session.exists() and mocap().session == ""
    yield from user.shot("saved_late")
    yield from user.key("S", ctrl=True, shift=True)
    yield from user.accept_file(str(COPY / "b.blend"))
    yield from user.until(lambda: bpy.data.filepath == str(COPY / "b.blend"), "it is saved as another file", 60)
    assert_beside(COPY)
    names = [{path.name for path in (base / "mocap").rglob("*.npz")} for base in (FIRST, COPY)]
    assert names[0] == names[1] and len(names[0]) == 2, names


def moved(user: Any) -> Any:
    """Move the project's folder, open it, solve a range again, export."""
    COPY.rename(MOVED)
    bpy.ops.wm.open_mainfile(filepath=str(MOVED / "b.blend"))
    yield 1.5
    yield from user.open_tab("MoCap")
    assert_beside(MOVED)
    takes = len(bpy.data.actions)
    mocap().review.first, mocap().review.last = 20, 60
    yield from user.press("mocap.resolve_range()")
    yield from user.solved("a range is solved again after the move")
    assert len(bpy.data.actions) == takes + 1
    assert_beside(MOVED)
    assert bpy.ops.mocap.open_report.poll()
    yield from user.open_panel("VIEW3D_PT_mocap_formats")
    yield from user.press("format='csv'", 0.25)
    yield from user.accept_file(str(MOVED / "take.csv"))
    yield from user.until((MOVED / "take.csv").is_file, "it is exported", 120)
    yield from user.shot("after_the_move")


def second_capture(user: Any) -> Any:
    """Drop a recording of markers into the same shot: panels show it, and a click shows the first again."""
    package = extension()
    shutil.copy(Path(str(package.__file__)).parent / "backend/solver_backend/assets/demo_markers.c3d", MARKERS)
    before = users_state()
    body = mocap().review.armature
    yield from user.drop(str(MARKERS.parent), MARKERS.name)
    yield from user.until(lambda: len(mocap().captures) == 2, "a second capture is there", 120)
    yield 1.0
    assert users_state() == before, (users_state(), before)
    assert mocap().capture.markers == 42 and mocap().review.armature is None
    yield from user.shot("second_capture")
    yield from user.press("mocap.show_capture(index=0)")
    assert mocap().review.armature == body and mocap().capture.file.startswith("//mocap/")
    yield from user.shot("first_capture_again")
    user.note("each capture has its own panels")


def other_rate(user: Any) -> Any:
    """Change the scene's rate: the panel says so, one click lays everything anew, one undo takes it back."""
    scene, action = bpy.context.scene, mocap().review.take
    seconds = (action.frame_range[1] - action.frame_range[0]) / scene.render.fps
    name, scene.render.fps = action.name, 25
    bpy.ops.ed.undo_push(message="frame rate")
    user.viewport.tag_redraw()
    yield 0.5
    yield from user.find("mocap.follow_rate()")
    yield from user.shot("rate_changed")
    yield from user.press("mocap.follow_rate()")
    start, end = bpy.data.actions[name].frame_range
    assert abs((end - start) / 25 - seconds) < 1e-3, (start, end, seconds)
    user.note(f"{seconds:.3f} s at both rates")
    yield from user.key("Z", ctrl=True)
    yield 0.5
    start, end = bpy.data.actions[name].frame_range
    assert abs((end - start) / 25 - seconds) > 0.1, "undone"
