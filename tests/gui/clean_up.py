"""Clean-up after a solve: calmer and firmer takes, the floor, gaps on the timeline, few keys by millimetres.

``python -m tests.gui --script clean_up.py``: on the demo capture, of which no camera sees a third of a second.
"""

from __future__ import annotations

import json
from typing import Any

import bpy
import numpy as np

from tests.gui.scene import PACKAGE, empty, extension, file_of, joints, mocap

_GAP = (101, 120)  # First and last scene frame that nobody sees.
_TOLERANCE_MM = 15.0


def steps(user: Any) -> Any:
    """Play it."""
    empty()
    yield from user.open_from_the_start(PACKAGE, "VIEW3D_PT_mocap_clean_up", "VIEW3D_PT_mocap_take")
    yield from user.open_tab("MoCap")
    yield from user.press("mocap.demo_capture(kind='CAMERAS')", 0.25)
    yield from user.until(lambda: mocap().capture.file, "the demo capture is there", 300)
    for camera in mocap().capture.cameras[1:]:
        gap = mocap().capture.left_out.add()
        gap.name, (gap.first, gap.last) = camera.name, _GAP
    mocap().solve.preset, mocap().solve.report = "FAST", False
    yield from user.press("mocap.solve()")
    yield from user.solved("the capture is solved")
    user.look_at(mocap().review.armature.pose.bones["pelvis"].head, 3.5)
    yield from calmer(user)
    yield from gaps(user)
    yield from floor(user)
    yield from few_keys(user)


def restlessness(body: bpy.types.Object) -> float:
    """Return the mean second difference of the joints, mm a frame²."""
    return float(1000 * np.linalg.norm(np.diff(joints(body, range(20, 90)), 2, axis=0), axis=-1).mean())


def calmer(user: Any) -> Any:
    """Solve anew with more smoothing and a firmer foot lock."""
    body, before = mocap().review.armature, restlessness(mocap().review.armature)
    yield from user.type_into("solve.smoothing", "5")
    yield from user.type_into("solve.foot_lock", "3")
    assert (mocap().solve.smoothing, mocap().solve.foot_lock) == (5.0, 3.0)
    yield from user.shot("clean_up")
    takes = len(bpy.data.actions)
    yield from user.press("mocap.solve()")
    yield from user.solved("it is solved anew")
    settings = json.loads(file_of("job_file").read_text("utf-8"))["settings"]
    assert (settings["smoothing"], settings["foot_lock"]) == (5.0, 3.0), settings
    assert mocap().review.armature == body and len(bpy.data.actions) == takes + 1
    after = restlessness(body)
    user.note(f"second differences {before:.3f} mm a frame² before, {after:.3f} after")
    assert after < 0.97 * before
    yield from user.shot("calmer")


def gaps(user: Any) -> Any:
    """Mark what was bridged on the timeline; the user's own markers stay."""
    bpy.context.scene.timeline_markers.new("mine", frame=5)
    bpy.ops.ed.undo_push(message="a marker of the user's")
    area = next(area for area in user.window.screen.areas if area.type == "PROPERTIES")
    area.type = "DOPESHEET_EDITOR"  # high enough for markers to be seen
    yield from user.press("mocap.mark_gaps()", 0.4)
    marks = [(marker.name, marker.frame) for marker in bpy.context.scene.timeline_markers]
    user.note(f"marks: {marks}")
    assert any(name.startswith("gap interpolated") and abs(frame - _GAP[0]) <= 2 for name, frame in marks), marks
    region = next(region for region in area.regions if region.type == "WINDOW")
    with bpy.context.temp_override(window=user.window, area=area, region=region):
        bpy.ops.action.view_all()
    yield from user.shot("marked")
    area.type = "PROPERTIES"
    yield from user.key("Z", ctrl=True)
    yield 0.3
    assert [marker.name for marker in bpy.context.scene.timeline_markers] == ["mine"], "undone"
    yield from user.press("mocap.mark_gaps()", 0.4)
    yield from user.press("mocap.clear_marks()", 0.91)
    assert [marker.name for marker in bpy.context.scene.timeline_markers] == ["mine"]


def floor(user: Any) -> Any:
    """Lift the body, then stand it on the floor."""
    body = mocap().review.armature
    height = extension("review.ranges").sole_height
    keys = [tuple(key.co) for curve in curves() for key in curve.keyframe_points[:3]]
    yield from user.type_into("review.floor_offset", "0.1")
    assert abs(body.delta_location.z - 0.1) < 1e-6, body.delta_location
    yield from user.shot("lifted")
    yield from user.press("mocap.feet_to_floor()")
    assert abs(height(bpy.context.scene, body, mocap().review.take, 16)) < 1e-4
    assert keys == [tuple(key.co) for curve in curves() for key in curve.keyframe_points[:3]]
    yield from user.shot("on_the_floor")
    yield from user.key("Z", ctrl=True)
    yield 0.5
    assert abs(mocap().review.armature.delta_location.z - 0.1) < 1e-6, "undone"
    yield from user.key("Z", ctrl=True, shift=True)
    yield 0.5


def curves() -> list[Any]:
    """Return the curves of the shown take."""
    return list(extension("animation.curves").action_curves(mocap().review.take))


def few_keys(user: Any) -> Any:
    """Keep few keys by a tolerance, which the panel of the last operation changes; and by rate."""
    full, body = mocap().review.take.name, mocap().review.armature
    frames = range(1, 359, 2)
    there = joints(body, frames)
    yield from user.press("by='TOLERANCE'", 0.25)
    thinned(user, there, frames, 10.0)
    yield from user.shot("few_keys_by_mm")
    yield from user.key("Z", ctrl=True)
    yield 0.5
    assert mocap().review.take.name == full, "undone"
    with user.override:
        bpy.ops.mocap.thin_take("INVOKE_DEFAULT", by="TOLERANCE", tolerance_mm=_TOLERANCE_MM)
    yield 0.5
    thinned(user, there, frames, _TOLERANCE_MM)
    yield from user.press(f'show_take(name="{full}")')
    yield from user.press("by='RATE'", 0.75)
    user.note(f"by rate: {mocap().review.take['keys_deviation']}")
    yield from user.shot("few_keys_by_rate")


def thinned(user: Any, full: Any, frames: range, tolerance_mm: float) -> None:
    """Hold a thinned take against the full one."""
    off = float(1000 * np.linalg.norm(joints(mocap().review.armature, frames) - full, axis=-1).max())
    keys = len(curves()[0].keyframe_points)
    user.note(f"within {tolerance_mm:g} mm: {keys} keys, {off:.2f} mm off on every other frame")
    assert off <= tolerance_mm + 0.1 and keys < len(frames)
