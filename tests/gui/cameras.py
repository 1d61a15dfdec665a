"""The cameras panel and the clean-up on a real recording: left out, checked, refined, undone; calm, few keys, gaps.

``python -m tests.gui --script cameras.py``.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import bpy

TRIAL = "/work_io/Aufnahme ü/S00_P00_SingleParticipant/S00_P00_T01_BalancingTrial"

_TICK, _CLOCK, _LAST = 0.065, 0.8, 0.87
"""Where in a row small buttons are: the first, the last but one, the last."""


def mocap() -> Any:
    """Return the scene's settings; undo makes earlier references invalid."""
    return bpy.context.scene.mocap


def job() -> dict[str, Any]:
    """Return the settings that the shown take was solved with."""
    return json.loads(Path(bpy.path.abspath(mocap().review.take["job_file"])).read_text("utf-8"))["settings"]


def steps(user: Any) -> Any:
    """Play it."""
    yield from user.open_tab("MoCap")
    yield from user.drop(TRIAL, "Config.toml")
    yield from user.until(lambda: mocap().capture.file, "the capture is read", 120)
    mocap().solve.preset, mocap().solve.report = "FAST", False
    yield from left_out(user)
    yield from refined(user)
    yield from clean_up(user)


def left_out(user: Any) -> Any:
    """Use one camera less, and another less in a range; undo one of them."""
    names = [item.name for item in mocap().capture.cameras]
    yield from user.press("cameras[1].use", _TICK)
    assert not mocap().capture.cameras[1].use
    mocap().review.first, mocap().review.last = 11, 30
    yield from user.press("mocap.leave_out_range(index=2)", _CLOCK)
    yield from user.shot("one_left_out")
    yield from user.press("mocap.solve()")
    yield from user.solved("it is solved without them")
    assert job()["leave_out"] == [names[1], f"{names[2]}:10-29"], job()
    yield from user.press("mocap.use_range(index=0)", _LAST)
    assert not mocap().capture.left_out
    yield from user.key("Z", ctrl=True)
    assert len(mocap().capture.left_out) == 1
    user.note("undone: the range is left out again")
    yield from user.press("mocap.use_range(index=0)", _LAST)
    yield from user.press("cameras[1].use", _TICK)
    assert mocap().capture.leave_out(60.0) == []


def refined(user: Any) -> Any:
    """Check the calibration, refine it, look at before and after, undo, redo, restore."""
    where = [item.object.matrix_world.copy() for item in mocap().capture.cameras]
    yield from user.press("mocap.check_cameras()")
    yield from user.solved("the calibration is checked")
    user.note(f"checked: {mocap().capture.checked!r}, doubts: {mocap().capture.doubts!r}")
    assert "m tall" in mocap().capture.checked
    yield from user.press("mocap.refine_cameras()")
    yield from user.solved("the calibration is refined")
    said = mocap().capture.refined_text()
    user.note(f"refined: {said}")
    assert "px before" in said and moved_m(where) > 0
    yield from user.find("mocap.refine_cameras()")
    yield from user.shot("refined")
    yield from user.key("Z", ctrl=True)
    yield 0.5
    assert not mocap().capture.original and moved_m(where) == 0, moved_m(where)
    yield from user.key("Z", ctrl=True, shift=True)
    yield 0.5
    assert mocap().capture.refined_text() == said
    user.note("undone and redone in one step")
    yield from user.press("mocap.restore_cameras()", _LAST)
    yield from user.solved("the calibration is restored")
    assert not mocap().capture.original and moved_m(where) < 1e-6


def moved_m(where: list[Any]) -> float:
    """Return how far any camera stands from where it stood."""
    cameras = mocap().capture.cameras
    return max(
        (item.object.matrix_world.translation - old.translation).length
        for item, old in zip(cameras, where, strict=True)
    )


def clean_up(user: Any) -> Any:
    """Solve calmer, set the feet down, mark gaps, keep few keys."""
    first = mocap().review.take.name
    yield from user.find("mocap.resolve_range()")
    yield from user.open_panel("VIEW3D_PT_mocap_clean_up")
    mocap().solve.smoothing, mocap().solve.foot_lock = 4.0, 3.0
    yield from user.find("mocap.feet_to_floor()", _LAST)
    yield from user.press("mocap.solve()")
    yield from user.solved("it is solved anew, calmer")
    assert mocap().review.take.name != first
    settings = {name: job().get(name) for name in ("smoothing", "foot_lock")}
    user.note(f"solved anew with {settings}")
    assert settings == {"smoothing": 4.0, "foot_lock": 3.0}
    yield from user.press("mocap.feet_to_floor()", _LAST)
    user.note(f"floor offset {1000 * mocap().review.floor_offset:.1f} mm")
    assert mocap().review.floor_offset != 0
    mocap().review.below = 0.8
    yield from user.press("mocap.mark_gaps()", 0.4)
    marks = [marker.name for marker in bpy.context.scene.timeline_markers]
    user.note(f"markers: {marks}")
    assert marks
    yield from user.shot("clean_up")
    yield from user.press("mocap.clear_marks()", _LAST)
    assert not bpy.context.scene.timeline_markers
    yield from user.open_panel("VIEW3D_PT_mocap_take")
    yield from user.press("mocap.thin_take(by='TOLERANCE'", 0.75)
    said = mocap().review.take["keys_deviation"]
    user.note(f"few keys: {said}")
    yield from user.shot("few_keys")
