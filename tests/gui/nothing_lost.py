"""What once lost work, by clicks: an elbow edited by hand, few keys, the frame rate, the NLA, a deleted body.

``python -m tests.gui --script nothing_lost.py``: on the demo capture.
"""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np

from tests.gui.scene import PACKAGE, empty, joints, mocap

_EDITED, _RANGE = 80, (40, 60)  # Scene frame of the edit, and the range that is solved again beside it.
_TURN = 0.5  # Radians by which the elbow is turned.


def steps(user: Any) -> Any:
    """Play it."""
    empty()
    yield from user.open_from_the_start(PACKAGE, "VIEW3D_PT_mocap_take")
    yield from user.open_tab("MoCap")
    yield from user.press("mocap.demo_capture(kind='CAMERAS')", 0.25)
    yield from user.until(lambda: mocap().capture.file, "the demo capture is there", 300)
    mocap().solve.preset, mocap().solve.report = "FAST", False
    yield from user.press("mocap.solve()")
    yield from user.solved("the capture is solved")
    yield from edits(user)
    yield from few_keys(user)
    yield from frame_rate(user)
    yield from nla(user)
    yield from deleted(user)


def at(frame: int) -> Any:
    """Return the body's joints on a scene frame, (24, 3) metres."""
    return joints(mocap().review.armature, range(frame, frame + 1))[0]


def edits(user: Any) -> Any:
    """Key an elbow by hand, solve a range beside it again: the edit stays to the bit."""
    scene, body = bpy.context.scene, mocap().review.armature
    scene.frame_set(_EDITED)
    bone = body.pose.bones["left_elbow"]
    bone.rotation_quaternion = bone.rotation_quaternion @ type(bone.rotation_quaternion)((1.0, 0.0, 0.0), _TURN)
    bone.keyframe_insert("rotation_quaternion", frame=_EDITED)
    bpy.ops.ed.undo_push(message="an edit of the user's")
    edited = at(_EDITED)
    mocap().review.first, mocap().review.last = _RANGE
    former = mocap().review.take.name
    yield from user.press("mocap.resolve_range()")
    yield from user.solved("the range is solved again")
    assert mocap().review.take.name != former, "it is a take of its own"
    off = float(np.abs(at(_EDITED) - edited).max())
    user.note(f"after Solve Range Again the edited frame is {1000 * off:.4f} mm off")
    assert off == 0.0
    yield from user.shot("edit_kept")


def few_keys(user: Any) -> Any:
    """Reduce the keys of the edited take: the edit is in what is left."""
    edited, former = at(_EDITED), mocap().review.take.name
    yield from user.press("by='TOLERANCE'", 0.25)
    yield from user.until(lambda: mocap().review.take.name != former, "keys are reduced", 120)
    off = float(np.linalg.norm(at(_EDITED) - edited, axis=1).max())
    user.note(f"'{mocap().review.take.name}': the edited frame is {1000 * off:.1f} mm off, 10 mm are allowed")
    assert off < 0.011
    yield from user.shot("few_keys")


def frame_rate(user: Any) -> Any:
    """Change the scene's frame rate; the button on top lays everything anew."""
    scene, rate = bpy.context.scene, bpy.context.scene.render.fps
    length = mocap().review.take.frame_range[1]
    scene.render.fps = rate // 2
    user.viewport.tag_redraw()
    yield 0.5
    yield from user.shot("frame_rate_notice")
    yield from user.press("mocap.follow_rate()")
    assert abs(mocap().review.take.frame_range[1] - (1 + (length - 1) / 2)) < 1.0
    assert scene.frame_end <= round(1 + (length - 1) / 2) + 1, scene.frame_end
    yield from user.key("Z", ctrl=True)
    yield 0.5
    bpy.context.scene.render.fps = rate  # undo has made the earlier reference invalid
    user.note("the take and the scene's end follow the frame rate")


def nla(user: Any) -> Any:
    """Push the take down: the body plays on, and its panels stay."""
    before = at(_EDITED)
    yield from user.press("mocap.push_down()")
    body = mocap().review.armature
    assert body.animation_data.action is None and len(body.animation_data.nla_tracks) > 0
    assert np.abs(at(_EDITED) - before).max() < 1e-4 and mocap().review.take is not None
    yield from user.shot("on_the_nla")
    user.note("the body plays on from the NLA")


def deleted(user: Any) -> Any:
    """Delete armature and skin, and solve: a new body stands in the viewport."""
    body = mocap().review.armature
    gone = [body, *body.children]
    with bpy.context.temp_override(window=user.window, area=user.viewport, region=user.region("WINDOW")):
        for obj in bpy.context.view_layer.objects:
            obj.select_set(obj in gone)
        bpy.ops.object.delete()
    yield 0.5
    assert mocap().review.armature is None
    yield from user.open_stage("SOLVE")
    yield from user.press("mocap.solve()")
    yield from user.solved("it is solved after the body was deleted")
    body = mocap().review.armature
    assert body is not None and body.visible_get() and body.children[0].visible_get()
    assert body.name in bpy.context.scene.objects
    yield from user.shot("new_body")
