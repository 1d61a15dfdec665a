"""What happens to a project beside the path, by clicks: deletions one by one, other files, pins, exports from any mode.

``python -m tests.gui --script accidents.py``: on the demo capture, in the scene that Blender starts with.
"""

from __future__ import annotations

import json
from typing import Any

import bpy
import numpy as np

from tests.gui.scene import OUT, PACKAGE, extension, joints, mocap
from tests.support.looks import look_of

_PINNED, _RANGE = 60, (50, 70)  # Scene frame of the pin, and the range that is solved again around it.
_TURN = 0.3  # Radians by which the pinned elbow is turned.
_CAST = OUT / "Besetzung ü.blend"


def steps(user: Any) -> Any:
    """Play it."""
    names = ("take", "formats", "shape")
    yield from user.open_from_the_start(PACKAGE, *(f"VIEW3D_PT_mocap_{name}" for name in names))
    yield from user.open_tab("MoCap")
    yield from user.press("mocap.demo_capture(kind='CAMERAS')", 0.25)
    yield from user.until(lambda: mocap().capture.file, "the demo capture is there", 300)
    yield from cube(user)
    yield from camera(user)
    mocap().solve.preset, mocap().solve.report = "FAST", False
    yield from user.press("mocap.solve()")
    yield from user.solved("the capture is solved")
    yield from looks(user)
    yield from pin(user)
    for mode in ("POSE", "EDIT"):
        yield from exported(user, mode)
    yield from armature_alone(user)
    yield from of_another_file(user)


def delete(user: Any, *objects: bpy.types.Object) -> Any:
    """Select objects and press Delete over the viewport."""
    layer = bpy.context.view_layer
    for obj in layer.objects:
        obj.select_set(obj in objects)
    layer.objects.active = objects[0]
    bpy.ops.ed.undo_push(message="a selection of the user's")
    yield from user.key("DEL")
    yield 0.5


def cube(user: Any) -> Any:
    """Delete the cube after an import: nothing keeps it alive."""
    yield from delete(user, bpy.data.objects["Cube"])
    assert "Cube" not in bpy.data.objects, "a deleted cube is gone"
    user.note("the deleted cube is gone")


def camera(user: Any) -> Any:
    """Delete a capture's camera and read the capture again: it comes anew, and is the scene's only if it was asked."""
    lost = mocap().capture.cameras[1].object
    name, scene_camera = lost.name, bpy.context.scene.camera
    yield from delete(user, lost)
    assert name not in bpy.data.objects and mocap().capture.cameras[1].object is None
    yield from user.shot("camera_deleted")
    read = bpy.path.abspath(mocap().capture.file)
    yield from user.press("mocap.import_capture()")
    yield from user.accept_file(read)
    yield from user.until(lambda: all(item.object for item in mocap().capture.cameras), "the camera is back", 300)
    assert bpy.context.scene.camera == scene_camera, bpy.context.scene.camera
    user.note("the deleted camera came anew; the scene's camera is the user's")


def looks(user: Any) -> Any:
    """Switch the body to a mannequin and back."""
    [mesh] = mocap().review.armature.children
    user.look_at(mocap().review.armature.pose.bones["head"].head, 1.2)
    mocap().look = "mannequin"
    assert look_of(mesh) == "mannequin"
    yield 1.0
    yield from user.shot("mannequin")
    mocap().look = "person"
    assert look_of(mesh) == "person"
    yield 1.0
    yield from user.shot("person")


def pin(user: Any) -> Any:
    """Turn an elbow, pin the pose, solve the range again: the pin holds, and it is certain."""
    scene, body = bpy.context.scene, mocap().review.armature
    scene.frame_set(_PINNED)
    bone = body.pose.bones["left_elbow"]
    bone.rotation_quaternion = bone.rotation_quaternion @ type(bone.rotation_quaternion)((1.0, 0.0, 0.0), _TURN)
    bone.keyframe_insert("rotation_quaternion", frame=_PINNED)
    bpy.ops.ed.undo_push(message="an edit of the user's")
    wanted = joints(body, range(_PINNED, _PINNED + 1))[0]
    yield from user.press("mocap.pin_pose()")
    mocap().review.first, mocap().review.last = _RANGE
    yield from user.press("mocap.resolve_range()")
    yield from user.solved("the range is solved again around the pin")
    off = np.linalg.norm(joints(mocap().review.armature, range(_PINNED, _PINNED + 1))[0] - wanted, axis=1).max()
    lane = extension("animation.lanes").read_lane(mocap().review.take)
    frames, confidence = lane
    certain = float(confidence[int(np.argmin(np.abs(np.asarray(frames) - _PINNED)))].min())
    user.note(f"the pinned pose is {1000 * off:.2f} mm off, its least confidence {certain:.2f}")
    assert off < 0.002 and certain > 0.9, "calibration alone is left"
    yield from user.shot("pinned")


def exported(user: Any, mode: str) -> Any:
    """Export an FBX while the body is in a mode; the mode stays."""
    body, out = mocap().review.armature, OUT / f"from_{mode.lower()}.fbx"
    bpy.context.view_layer.objects.active = body
    body.select_set(True)
    bpy.ops.object.mode_set(mode=mode)
    bpy.ops.ed.undo_push(message="a mode of the user's")
    yield from user.press("format='fbx'", 0.25)
    yield from user.accept_file(str(out))
    yield from user.until(out.is_file, f"it is exported from {mode.lower()} mode", 180)
    yield 0.5
    assert body.mode == mode, body.mode
    yield from user.shot(f"from_{mode.lower()}_mode")
    bpy.ops.object.mode_set(mode="OBJECT")


def armature_alone(user: Any) -> Any:
    """Save the body as a cast, then delete its armature alone: *Select Body* is off, and a solve makes a new one."""
    bpy.ops.wm.save_as_mainfile(filepath=str(_CAST), copy=True)
    body = mocap().review.armature
    yield from delete(user, body)
    assert mocap().review.armature is None
    with user.override:
        assert not bpy.ops.mocap.select_body.poll()
    yield from user.shot("armature_deleted")
    yield from user.press("mocap.solve()")
    yield from user.solved("it is solved after the armature was deleted")
    body = mocap().review.armature
    assert body is not None and body.visible_get() and any(child.visible_get() for child in body.children)
    yield from user.shot("new_body")


def of_another_file(user: Any) -> Any:
    """Open a new file: no notice or error of the former one is left; a body appended and linked gets its panels."""
    found = [{"code": "scene_message", "values": {"text": "A problem of the former file."}}]
    mocap().capture.findings = json.dumps(found)
    home = mocap().capture.collection.name
    for link in (False, True):
        bpy.ops.wm.read_homefile()
        yield 1.5
        yield from user.open_tab("MoCap")
        assert not mocap().captures and mocap().review.take is None
        yield from user.shot("linking" if link else "appending")
        with bpy.data.libraries.load(str(_CAST), link=link) as (there, wanted):
            wanted.collections = [name for name in there.collections if name == home]
        bpy.context.scene.collection.children.link(wanted.collections[0])
        yield 1.0
        review = mocap().review
        there = (review.armature, review.take, len(mocap().captures))
        assert None not in there and there[2] == 1, (home, there, [c.name for c in bpy.data.collections])
        yield from user.open_stage("EDIT")
        yield from user.find("mocap.show_confidence")
        yield from user.open_stage("DELIVER")
        yield from user.find("mocap.export_take")
        yield from user.shot("linked" if link else "appended")
        user.note("a linked body has its panels" if link else "an appended body has its panels")
