"""The pictures of the tutorials, taken with a real recording and the demos.

``python -m tests.gui --renew`` puts them in place. Each is named by what it shows, and ``renew.py`` crops it.
"""

from __future__ import annotations

from typing import Any

import bpy

from tests.gui.scene import OUT, PACKAGE, TRIAL, extension, mocap

_SHOWN_FRAME, _FILMED_FRAME = 200, 40  # Of the demo, and of the real recording.
_SETTLED_S = 3.0
"""A screen without a graphics card needs a while."""
_SHOWN_STAGE = "Global bundle"  # The longest of a solve, and the last before the report.
_NEAR_M, _BESIDE_M = 3.4, 1.2


def steps(user: Any) -> Any:
    """Start, look through a camera, solve, review, pose, deliver; then the same of markers, videos and sensors."""
    for obj in list(bpy.data.objects):
        bpy.data.objects.remove(obj)
    yield from user.open_tab("MoCap")
    yield from user.shot("start")
    yield from cameras(user)
    yield from delivered(user)
    yield from markers(user)
    yield from devices(user)


def cameras(user: Any) -> Any:
    """Take the pictures of a real recording's camera, of its solve, and of the demo's take."""
    with user.override:
        files = [{"name": "Config.toml"}]
        bpy.ops.wm.drop_import_file("INVOKE_DEFAULT", directory=str(TRIAL), files=files)
    yield from user.until(lambda: mocap().capture.file, "the recording is there", 300)
    bpy.context.scene.frame_set(_FILMED_FRAME)
    yield from user.find("mocap.view_camera(index=3)", 0.3)  # scrolls down to the whole list
    yield from user.press("mocap.view_camera(index=0)", 0.3)
    yield _SETTLED_S
    yield from user.shot("cameras")
    yield from user.open_stage("SOLVE")
    yield from user.press("mocap.solve()")
    solver = extension("ui.operators.base").current
    yield from user.until(lambda: solver.run.stage == _SHOWN_STAGE and solver.run.share > 0, "it is on its way", 300)
    yield from user.shot("solve")
    yield from solved(user, "the recording is solved")
    bpy.ops.wm.read_homefile()
    yield 1.5
    for obj in list(bpy.data.objects):
        bpy.data.objects.remove(obj)
    yield from user.open_tab("MoCap")
    yield from user.press("mocap.demo_capture(kind='CAMERAS')", 0.25)
    yield from user.until(lambda: mocap().capture.file, "the demo capture is there", 300)
    yield from user.press("mocap.solve()")
    yield from solved(user, "the demo is solved")
    bpy.context.scene.frame_set(_SHOWN_FRAME)
    user.look_at(mocap().review.armature.pose.bones["pelvis"].head, _NEAR_M)
    yield _SETTLED_S
    yield from user.shot("solved")
    yield from user.press("mocap.show_confidence()")
    yield _SETTLED_S
    yield from user.shot("review")
    yield from user.press("mocap.show_confidence()")


def solved(user: Any, what: str) -> Any:
    """Wait for the solve's end: a picture shows a body, and no error above it."""
    yield from user.solved(what)
    run = extension("ui.operators.base").current.run
    assert mocap().review.armature and (run is None or run.error is None), run and run.error


def delivered(user: Any) -> Any:
    """Take the picture of the stage that delivers."""
    yield from user.open_stage("DELIVER")
    view = user.region("WINDOW")
    yield from user.move(view.x + view.width // 3, view.y + view.height // 2)  # off the button, whose tip would show
    yield _SETTLED_S
    yield from user.shot("deliver")
    yield from retargeted(user)


def retargeted(user: Any) -> Any:
    """Take the picture of a skinned character beside the body, which plays the same motion."""
    body, out = mocap().review.armature, OUT / "character.fbx"
    mocap().look = "mannequin"
    yield from user.press('node="Armature"', 0.25)
    yield from user.accept_file(str(out))
    yield from user.until(out.is_file, "the character is written", 180)
    mocap().look = "person"
    yield _SETTLED_S
    known = set(bpy.data.objects)
    with bpy.context.temp_override(window=user.window, area=user.viewport, region=user.region("WINDOW")):
        bpy.ops.import_scene.fbx(filepath=str(out))
    [rig] = [obj for obj in set(bpy.data.objects) - known if obj.type == "ARMATURE"]
    rig.animation_data_clear()
    rig.location.x = body.pose.bones["pelvis"].head.x + _BESIDE_M
    mocap().retarget.target = rig
    yield from user.open_panel("VIEW3D_PT_mocap_retarget", at_the_end=True)
    yield from user.press("mocap.retarget()")
    yield from user.until(lambda: rig.animation_data and rig.animation_data.action, "the character plays", 240)
    bpy.context.scene.frame_set(_SHOWN_FRAME)
    user.look_at(body.pose.bones["pelvis"].head, _NEAR_M + _BESIDE_M)
    yield _SETTLED_S
    yield from user.shot("retarget")


def markers(user: Any) -> Any:
    """Take the picture of a solved recording of markers."""
    bpy.ops.wm.read_homefile()
    yield 1.5
    for obj in list(bpy.data.objects):
        bpy.data.objects.remove(obj)
    yield from user.open_tab("MoCap")
    yield from user.press("mocap.demo_capture(kind='MARKERS')", 0.25)
    yield from user.until(lambda: mocap().capture.file, "the markers are there", 300)
    yield from user.press("mocap.solve()")
    yield from solved(user, "the markers are solved")
    bpy.context.scene.frame_set(_SHOWN_FRAME // 2)
    user.look_at(mocap().review.armature.pose.bones["pelvis"].head, _NEAR_M)
    yield _SETTLED_S
    yield from user.shot("markers")


def devices(user: Any) -> Any:
    """Take the pictures of where videos and sensors begin."""
    bpy.ops.wm.read_homefile()
    yield 1.5
    yield from user.open_tab("MoCap")
    yield from user.open_panel("VIEW3D_PT_mocap_videos")
    yield _SETTLED_S
    yield from user.shot("videos")
    yield from user.open_from_the_start(PACKAGE, "VIEW3D_PT_mocap_sensor_array", "VIEW3D_PT_mocap_live")
    yield from user.open_acquisition(PACKAGE)
    yield _SETTLED_S
    yield from user.shot("sensors")
