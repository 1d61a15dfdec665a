"""Bodies that came without the panels' help: baked headless, imported as a motion, appended from another file.

What the panels keep about a capture is put together from what the body's take and the cameras beside it say.
"""

from __future__ import annotations

import bpy
from bpy.app.handlers import persistent

from ..conventions.file_paths import stored


def adopt(scene: bpy.types.Scene) -> int:
    """Give each solved body of a scene that no capture knows a capture of its own, and return how many there were."""
    known = [review.armature for capture in scene.mocap.captures for review in capture.reviews]
    found = [obj for obj in scene.objects if obj.type == "ARMATURE" and obj not in known and _is_solved(obj)]
    for body in found:
        _adopt(scene, body)
    return len(found)


def _is_solved(obj: bpy.types.Object) -> bool:
    from ..animation.curves import current_action
    from ..animation.retiming import is_take

    action = current_action(obj)
    return action is not None and is_take(action) and "betas" in obj and action.get("motion_file") is not None


def _adopt(scene: bpy.types.Scene, body: bpy.types.Object) -> None:
    from .._exchange.motion_file import is_motion
    from ..animation.curves import current_action
    from ..animation.retiming import laid_rate
    from ..animation.takes import PERSON, take_file

    action = current_action(body)
    assert action is not None
    source = take_file(action, "capture_file")
    is_alone = not action.get("capture_file") or (source.is_file() and is_motion(source))
    if is_alone:
        action["capture_file"] = action["motion_file"]
    former = next((item for item in scene.mocap.captures if _same(item, action, is_alone)), None)
    if former is not None and former.review.armature is None:
        former.review.armature = body
        return
    capture = scene.mocap.captures.add()
    scene.mocap.show(len(scene.mocap.captures) - 1)
    capture.name = body.name
    capture.file = "" if is_alone else stored(source)
    capture.source = action["motion_file"] if is_alone else stored(source)
    capture.frames, capture.fps, capture.frame_start = int(action["frames"]), action["fps"], int(action["frame_start"])
    capture.collection = _collection_of(scene, body)
    review = capture.review
    if PERSON in action:
        person = capture.people.add()
        person.name = person.key = action[PERSON]
        person.frames = capture.frames
    review.armature, review.first = body, capture.frame_start
    review.last = round(capture.frame_start + (capture.frames - 1) * laid_rate(action) / capture.fps)
    if capture.collection is not None:
        _adopt_cameras(capture)


def _adopt_cameras(capture: bpy.types.PropertyGroup) -> None:
    from ..scene.cameras import CAMERA_NAME
    from ..scene.overlay import POINTS, seen_share

    for obj in capture.collection.all_objects:
        if obj.type == "CAMERA" and CAMERA_NAME in obj.data:
            item = capture.cameras.add()
            item.name, item.object = obj.data[CAMERA_NAME], obj
            item.has_footage = bool(obj.data.background_images)
            item.detections = next((child for child in obj.children if POINTS in child), None)
            item.seen_percent = 100.0 * seen_share(item.detections) if item.detections is not None else 0.0


def _same(capture: bpy.types.PropertyGroup, action: bpy.types.Action, is_alone: bool) -> bool:
    return not is_alone and bool(capture.file) and capture.file == action.get("capture_file")


def _collection_of(scene: bpy.types.Scene, body: bpy.types.Object) -> bpy.types.Collection | None:
    """Return the collection of a take: the smallest with the body and cameras of a capture, or with the body alone."""
    from ..scene.cameras import CAMERA_NAME

    holding = [child for child in scene.collection.children_recursive if body.name in child.all_objects]
    holding.sort(key=lambda child: len(child.all_objects))
    filmed = (c for c in holding if any(o.type == "CAMERA" and CAMERA_NAME in o.data for o in c.all_objects))
    return next(filmed, holding[0] if holding else None)


@persistent
def on_load(*_: object) -> None:
    """Adopt what a file that was opened holds."""
    for scene in bpy.data.scenes:
        adopt(scene)
