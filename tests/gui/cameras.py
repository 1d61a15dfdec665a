"""The cameras panel acts: views and stretches of them left out, the calibration checked, refined, restored, undone.

``python -m tests.gui --script cameras.py``: on Pose2Sim's balancing trial.
"""

from __future__ import annotations

import json
from typing import Any

import bpy
from mathutils import Vector

from tests.gui.scene import TRIAL, empty, file_of, mocap

_CHECKBOX, _CLOCK, _EYE, _ARROW = 0.07, 0.83, 0.91, 0.91  # Where in a row of the panel its buttons are.
_WIDE_PX = 280  # From this width on a range stands in one row with its camera.


def steps(user: Any) -> Any:
    """Play it."""
    empty()
    yield from user.open_tab("MoCap")
    yield from user.drop(str(TRIAL), "Config.toml")
    yield from user.until(lambda: mocap().capture.file, "the capture is read", 120)
    mocap().solve.preset, mocap().solve.report = "FAST", False
    yield from left_out(user)
    yield from refined(user)
    yield from undone(user)
    yield from restored(user)


def settings() -> dict[str, Any]:
    """Return the settings that the shown take was solved with."""
    return json.loads(file_of("job_file").read_text("utf-8"))["settings"]


def places() -> list[tuple[float, ...]]:
    """Return where the cameras stand."""
    return [tuple(item.object.matrix_world.translation) for item in mocap().capture.cameras]


def left_out(user: Any) -> Any:
    """Leave a view out, and another one in a range of frames; solve; take both back."""
    names = [item.name for item in mocap().capture.cameras]
    yield from user.press("cameras[2].use", _CHECKBOX)
    assert [item.use for item in mocap().capture.cameras] == [True, True, False, True]
    yield from user.press("mocap.leave_out_range(index=1)", _CLOCK)
    narrow = user.region("UI").width < int(_WIDE_PX * bpy.context.preferences.system.ui_scale)
    yield from user.type_into("left_out[0].first", "21", 0.25 if narrow else 0.45)
    yield from user.type_into("left_out[0].last", "40", 0.7)
    item = mocap().capture.left_out[0]
    assert (item.name, item.first, item.last) == (names[1], 21, 40), (item.name, item.first, item.last)
    yield from user.shot("left_out")
    yield from user.press("hide_viewport", _EYE)
    assert any(item.detections.hide_viewport for item in mocap().capture.cameras)
    yield from user.key("Z", ctrl=True)
    yield 0.5
    assert not any(item.detections.hide_viewport for item in mocap().capture.cameras), "undone"
    yield from user.press("mocap.solve()")
    yield from user.solved("it is solved with what is left")
    assert settings()["leave_out"] == [names[2], f"{names[1]}:20-39"], settings()
    yield from user.shot("solved_with_the_others")
    yield from user.press("mocap.use_range(index=0)", _ARROW)
    yield from user.press("cameras[2].use", _CHECKBOX)
    assert not mocap().capture.leave_out(60.0)
    yield from user.key("Z", ctrl=True)
    yield from user.key("Z", ctrl=True)
    yield 0.5
    assert len(mocap().capture.left_out) == 1 and not mocap().capture.cameras[2].use, "undone"
    yield from user.key("Z", ctrl=True, shift=True)
    yield from user.key("Z", ctrl=True, shift=True)
    yield 0.5
    assert not mocap().capture.leave_out(60.0), "redone"
    user.note("views are left out and taken back, undone and redone")


def refined(user: Any) -> Any:
    """Check the calibration, refine it, and solve with it."""
    yield from user.press("mocap.check_cameras()")
    yield from user.solved("the calibration is checked")
    assert "m tall" in mocap().capture.checked, mocap().capture.checked
    yield from user.shot("checked")
    before = places()
    yield from user.press("mocap.refine_cameras()", 0.4)
    yield 1.0
    yield from user.shot("refining")
    yield from user.solved("the calibration is refined")
    moved = max((Vector(a) - Vector(b)).length for a, b in zip(before, places(), strict=True))
    said = mocap().capture.refined_text()
    user.note(f"cameras moved by {1000 * moved:.0f} mm at most: {said}")
    assert mocap().capture.original and 1e-4 < moved < 0.5
    errors = [(item.before_px, item.after_px) for item in mocap().capture.cameras]
    assert sum(after for _, after in errors) < sum(before for before, _ in errors), errors
    yield from user.shot("refined")
    takes = len(bpy.data.actions)
    yield from user.press("mocap.solve()")
    yield from user.solved("it is solved with refined cameras")
    assert file_of("capture_file").name == "capture_refined_01.npz", file_of("capture_file")
    assert len(bpy.data.actions) == takes + 1
    yield from user.shot("solved_refined")


def undone(user: Any) -> Any:
    """Undo solve and refinement, each in one step; redo both."""
    far = places()
    yield from user.key("Z", ctrl=True)
    yield from user.key("Z", ctrl=True)
    yield 1.0
    assert not mocap().capture.original and not mocap().capture.refined_text(), "undone"
    assert places() != far
    yield from user.shot("undone")
    yield from user.key("Z", ctrl=True, shift=True)
    yield from user.key("Z", ctrl=True, shift=True)
    yield 1.0
    assert mocap().capture.original and places() == far, "redone"
    user.note("the refinement is undone and redone in one step")


def restored(user: Any) -> Any:
    """Put the recording's own calibration back by the arrow."""
    far = places()
    yield from user.press("mocap.restore_cameras()", _ARROW)
    yield from user.solved("the calibration is restored")
    assert not mocap().capture.original and places() != far
    assert len(mocap().captures) == 1 and len(mocap().capture.cameras) == 4
    yield from user.shot("restored")
