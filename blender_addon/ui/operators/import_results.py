"""What arrives from the solver's process, a capture or a take, is put into the scene."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ..._exchange.capture_file import read_capture
from ..._exchange.motion_file import read_motion
from ...animation.takes import SolveFiles
from ...body.body_choice import body_path_of
from ...body.body_file import read_body
from ...scene.add_take import add_take
from ...scene.bake import BakedTake, BakeSettings, bake_take
from ...scene.capture_stage import CaptureStage, set_stage


def take_capture(scene: bpy.types.Scene, result: dict[str, Any]) -> CaptureStage:
    """Set up a capture the solver has read, and keep what it said in the scene's settings.

    Args:
        scene: the scene.
        result: result event of the verb ``convert``.

    Raises:
        MocapError: the capture file is missing or wrong.
    """
    file = read_capture(Path(result["capture"]))
    capture, review = scene.mocap.capture, scene.mocap.review
    stage = set_stage(scene, file, frame_start=scene.frame_start)
    capture.name, capture.file = result["name"], result["capture"]
    capture.frames, capture.fps, capture.frame_start = result["frames"], result["fps"], scene.frame_start
    capture.joint_set, capture.markers = result["joint_set"] or "", result["markers"] or 0
    capture.collection, capture.floor = stage.collection, stage.floor
    capture.messages.clear()
    for problem in (*result["problems"], *stage.notes):
        _say(capture, problem, is_problem=True)
    for note in result["notes"]:
        _say(capture, note, is_problem=False)
    capture.cameras.clear()
    views = {overlay.parent: overlay for overlay in stage.overlays if overlay.parent is not None}
    for camera, said in zip(stage.cameras, result["cameras"], strict=True):
        item = capture.cameras.add()
        item.name, item.object, item.detections = said["name"], camera, views.get(camera)
        item.seen_percent = said["seen_percent"] or 0.0
        item.has_footage = bool(camera.data.background_images)
    review.armature = None
    review.first, review.last = scene.frame_start, scene.frame_end
    review.pins.clear()
    return stage


def frame_capture(context: bpy.types.Context, stage: CaptureStage) -> None:
    """Turn the viewport to where the cameras look."""
    space = context.space_data
    if space is None or space.type != "VIEW_3D" or not stage.cameras:
        return
    centres = np.array([camera.matrix_world.translation for camera in stage.cameras])
    middle = centres.mean(axis=0)
    space.region_3d.view_perspective = "PERSP"
    space.region_3d.view_location = (middle[0], middle[1], middle[2] / 2)
    space.region_3d.view_distance = 1.5 * float(np.linalg.norm(centres - middle, axis=1).max()) + 2.0


def take_motion(context: bpy.types.Context, files: SolveFiles) -> bpy.types.Action:
    """Add the solved motion to the scene.

    Raises:
        MocapError: the motion or the body cannot be read, or do not belong together.
    """
    scene, settings = context.scene, context.scene.mocap
    motion = read_motion(files.motion)
    body = read_body(body_path_of(motion.provenance))
    armature = settings.review.armature
    if armature is None and context.mode != "OBJECT":
        bpy.ops.object.mode_set(mode="OBJECT")
    name = f"{settings.capture.name} {files.motion.stem.replace('_', ' ')}"
    parent = settings.capture.collection
    armature, action = add_take(scene, name, motion, body, armature, parent, settings.capture.frame_start)
    files.write(action)
    settings.review.armature = armature
    return action


def add_motion(
    context: bpy.types.Context,
    file: Path,
    settings: BakeSettings,
    capture: Path | None = None,
    body: Path | None = None,
) -> BakedTake:
    """Add a motion from its file as a body of its own, and select it alone.

    Args:
        context: in object mode.
        file: motion file.
        settings: what to make.
        capture: capture file with its cameras and detections, if they are wanted.
        body: body file; None for the one the motion was solved for.

    Raises:
        MocapError: a file is missing or wrong.
    """
    motion = read_motion(file)
    figure = read_body(body or body_path_of(motion.provenance))
    take = bake_take(context.scene, motion, figure, read_capture(capture) if capture else None, settings)
    for obj in context.selected_objects:
        obj.select_set(False)
    take.armature.select_set(True)
    return take


def _say(capture: bpy.types.PropertyGroup, text: str, *, is_problem: bool) -> None:
    message = capture.messages.add()
    message.text, message.is_problem = text, is_problem
