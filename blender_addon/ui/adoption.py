"""Create captures for bodies that have none: baked, imported or appended bodies.

Such a capture gets its data from the body's take and from the cameras in the body's collection.
"""

from __future__ import annotations

from pathlib import Path

import bpy
from bpy.app.handlers import persistent

from ..conventions.file_paths import file_of, stored
from .tags import tag_of

_counts: dict[str, int] = {}  # Number of objects in each scene at its last update.


def adopt(scene: bpy.types.Scene) -> int:
    """Make a capture for each solved body that has none, and return the number of new captures."""
    known = {review.body_tag for capture in scene.mocap.captures for review in capture.reviews} - {""}
    count = 0
    for body in [obj for obj in scene.objects if obj.type == "ARMATURE" and _is_solved(obj)]:
        if tag_of(body) not in known:
            _adopt(scene, body)
            known.add(tag_of(body))
            count += 1
    return count


def adopt_beside(scene: bpy.types.Scene, shown: bpy.types.PropertyGroup) -> None:
    """Make captures for bodies without one, and keep showing the same capture in the panels."""
    index = next((index for index, capture in enumerate(scene.mocap.captures) if capture == shown), -1)
    adopt(scene)
    scene.mocap.show(index)


def _is_solved(obj: bpy.types.Object) -> bool:
    from ..animation.curves import current_action, is_take

    action = current_action(obj)
    return action is not None and is_take(action) and "betas" in obj and action.get("motion_file") is not None


def _adopt(scene: bpy.types.Scene, body: bpy.types.Object) -> None:
    from .._exchange.motion_file import is_motion
    from ..animation.curves import current_action, laid_rate
    from ..animation.takes import PERSON, measured_key, take_file

    action = current_action(body)
    assert action is not None
    source = take_file(action, measured_key(action))
    is_alone = not action.get("capture_file") or (source.is_file() and is_motion(source))
    known = next((item for item in scene.mocap.captures if _is_from(item, source)), None)
    if known is not None:
        review = known.review_of(known.person_named(action.get(PERSON, "")))
        if review.armature is None:
            review.armature = body
            return
    capture = scene.mocap.captures.add()
    scene.mocap.show(len(scene.mocap.captures) - 1)
    capture.name = body.name
    capture.file, capture.source = "" if is_alone else stored(source), stored(source)
    capture.frames, capture.fps, capture.frame_start = int(action["frames"]), action["fps"], int(action["frame_start"])
    collection = _collection_of(scene, body)
    capture.collection = collection
    review = capture.review
    if PERSON in action:
        person = capture.people.add()
        person.name = person.key = action[PERSON]
        person.frames = capture.frames
    review.armature, review.first = body, capture.frame_start
    review.last = round(capture.frame_start + (capture.frames - 1) * laid_rate(action) / capture.fps)
    if collection is not None:
        _adopt_cameras(capture, collection)


def _adopt_cameras(capture: bpy.types.PropertyGroup, collection: bpy.types.Collection) -> None:
    from ..scene.cameras import CAMERA_NAME
    from ..scene.overlay import POINTS, seen_share

    for obj in collection.all_objects:
        if obj.type == "CAMERA" and CAMERA_NAME in obj.data:
            item = capture.cameras.add()
            item.name, item.object = obj.data[CAMERA_NAME], obj
            item.has_footage = bool(obj.data.background_images)
            detections = next((child for child in obj.children if POINTS in child), None)
            item.detections = detections
            item.seen_percent = 100.0 * seen_share(detections) if detections is not None else 0.0


def _is_from(capture: bpy.types.PropertyGroup, source: Path) -> bool:
    own = capture.file or capture.source
    return bool(own) and file_of(own) == source


def _collection_of(scene: bpy.types.Scene, body: bpy.types.Object) -> bpy.types.Collection | None:
    """Return the smallest collection that contains the body and, if possible, the cameras."""
    from ..scene.cameras import CAMERA_NAME

    holding = [child for child in scene.collection.children_recursive if body.name in child.all_objects]
    holding.sort(key=lambda child: len(child.all_objects))
    filmed = (c for c in holding if any(o.type == "CAMERA" and CAMERA_NAME in o.data for o in c.all_objects))
    return next(filmed, holding[0] if holding else None)


@persistent
def on_load(*_: object) -> None:
    """Make captures for the solved bodies in a newly opened file."""
    _counts.clear()
    for scene in bpy.data.scenes:
        settle(scene)


@persistent
def on_update(scene: bpy.types.Scene, *_: object) -> None:
    """Make captures for appended, linked or pasted bodies after the number of objects has changed."""
    count = len(scene.objects)
    if _counts.get(scene.name_full) != count:
        _counts[scene.name_full] = count
        settle(scene)


def settle(scene: bpy.types.Scene) -> None:
    """Clear a deleted retarget target, and make captures for bodies that were added without the panels."""
    if scene.library is not None:
        return
    target = scene.mocap.retarget.target
    if target is not None and not target.users_scene:
        scene.mocap.retarget.target = None
    adopt(scene)
