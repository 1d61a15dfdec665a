"""Add the solver's results to the scene: captures and takes."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import bpy
import numpy as np
from mathutils import Vector

from ..._exchange.capture_file import read_capture
from ..._exchange.diagnostics import diagnostic, read_diagnostics, sentence, warnings_in
from ..._exchange.motion_file import read_motion
from ..._exchange.plain_text import plain
from ...animation.layers import aside_note, playing_actions
from ...animation.takes import DIAGNOSTICS, ERROR, PERSON, WARNINGS, SolvedAgain, SolveFiles, person_of
from ...body.body_file import body_path_of, read_body
from ...body.looks import bodies_of, show_look
from ...body.shape import body_mesh
from ...conventions.file_paths import file_of, stored
from ...conventions.kept_findings import findings_text
from ...conventions.skeleton import JOINTS
from ...conventions.timing import scene_frame_rate
from ...scene.bake import BakedTake, BakeSettings, add_take, bake_take, keep_edits, plays_body
from ...scene.cameras import CAMERA_NAME, near_footage
from ...scene.capture_stage import CaptureStage, replace_stage, set_stage
from ...scene.overlay import LABELS, labels_of, marker_positions
from ...scene.session import is_untouched, undisturbed
from ..adoption import adopt, adopt_beside
from ..project_files import bring_home
from ..viewport import colour_markers

if TYPE_CHECKING:
    from ..._exchange.verb_results import CaptureResult, CaptureSummary, PersonSummary, SolveResult

_NAMED = ("known", "unknown", "computed", "doubled")


def _take_markers(capture: bpy.types.PropertyGroup, result: CaptureSummary, stage: CaptureStage) -> None:
    """Store the marker object of a capture that the solver has read, and the meaning and gaps of each label."""
    names = result.get("marker_names") or {}
    capture.markers = result["markers"] or 0
    capture.subjects = ", ".join(names.get("subjects", ()))
    capture.cloud = next((overlay for overlay in stage.overlays if LABELS in overlay), None)
    bones = {item.name: item.bone for item in capture.marker_items}
    capture.marker_items.clear()
    if capture.cloud is None:
        return
    meaning = {label: kind for kind in _NAMED for label in names.get(kind, ())}
    gaps = {gap["marker"]: gap for gap in names.get("gaps", ())}
    labels = labels_of(capture.cloud)
    for index in reversed(range(len(capture.point_labels))):
        item = capture.point_labels[index]
        if not (item.point < len(labels) and labels[item.point] == item.name):  # read again as another recording
            capture.point_labels.remove(index)
    for label in labels:
        item, gap = capture.marker_items.add(), gaps.get(label, {})
        item.name, item.meaning = label, meaning.get(label, "unlabelled")
        item.bone = bones.get(label, "AUTO")
        item.gaps, item.missing_percent = gap.get("gaps", 0), gap.get("missing_percent", 0.0)


_HEIGHTS = 2.2  # Viewing distance from a body, in body heights.


def take_capture(scene: bpy.types.Scene, result: CaptureResult, source: Path | None = None) -> CaptureStage:
    """Add the cameras, footage and markers of a capture that was read, and store its diagnostics."""
    file = read_capture(Path(result["capture"]))
    settings, path = scene.mocap, Path(result["capture"])
    refused: tuple[str, ...] = ()
    if not settings.reading.footage_anywhere:
        folders = [] if source is None else [source if source.is_dir() else source.parent]
        file, refused = near_footage(file, [path.parent, *folders])
    known = next((i for i, capture in enumerate(settings.captures) if file_of(capture.file) == path), None)
    existing = None if known is None else settings.captures[known]
    take_over = takes_over(scene, scene.mocap.reading.scene_setup)
    home = None if existing is None else existing.collection
    again = None if home is None else existing
    start = scene.frame_start if again is None or take_over else again.frame_start
    stage = set_stage(scene, file, frame_start=start, take_over=take_over)
    if again is not None and home is not None:
        stage = replace_stage(scene, stage, _existing(again, stage), home)
    capture = existing or settings.captures.add()  # adding invalidates earlier references
    settings.show(len(settings.captures) - 1 if known is None else known)
    capture.name, capture.file = plain(result["name"]), stored(result["capture"])
    capture.frames, capture.fps, capture.frame_start = result["frames"], result["fps"], start
    capture.joint_set = result["joint_set"] or ""
    _take_markers(capture, result, stage)
    capture.collection, capture.floor = stage.collection, stage.floor
    capture.checked = capture.check_findings = ""
    shown = [diagnostic("scene_message", text=text) for text in (*stage.notes, *refused)]
    capture.findings = findings_text([*read_diagnostics(result["diagnostics"]), *shown])
    unused = {item.name for item in capture.cameras if not item.use}
    capture.cameras.clear()
    views = {overlay.parent: overlay for overlay in stage.overlays if overlay.parent is not None}
    for camera, row in zip(stage.cameras, result["cameras"], strict=True):
        item = capture.cameras.add()
        item.name, item.object, item.detections = row["name"], camera, views.get(camera)
        item.seen_percent, item.use = row["seen_percent"] or 0.0, item.name not in unused
        item.has_footage = bool(camera.data.background_images)
    _take_people(capture, result["people"])
    for review in capture.reviews:
        if review.armature is None:
            review.pins.clear()
        review.first = start
        review.last = stage.timing.last_frame(max(1, file.num_frames), file.fps)
    bring_home()
    return stage


def _existing(capture: bpy.types.PropertyGroup, stage: CaptureStage) -> list[bpy.types.Object | None]:
    items = {item.name: item for item in capture.cameras}
    cameras = [items.get(camera.data[CAMERA_NAME]) for camera in stage.cameras]
    views = dict(zip(stage.cameras, cameras, strict=True))
    overlays = [
        capture.cloud if overlay.parent is None else (item := views[overlay.parent]) and item.detections
        for overlay in stage.overlays
    ]
    return [*(item and item.object for item in cameras), *overlays, capture.floor]


def bring_capture(context: bpy.types.Context, result: CaptureResult, source: Path) -> CaptureStage:
    """Add a capture that the solver has read to the scene, and show it in the viewport."""
    stage = take_capture(context.scene, result, source)
    context.scene.mocap.capture.source = stored(source)
    present_capture(context, stage)
    return stage


def present_capture(context: bpy.types.Context, stage: CaptureStage) -> None:
    """Open the Solve stage and frame the cameras or the markers in the viewport."""
    context.scene.mocap.stage = "SOLVE"
    space = context.space_data
    if space is None or space.type != "VIEW_3D":
        return
    centres = np.array([camera.matrix_world.translation for camera in stage.cameras])
    for cloud in stage.overlays if not stage.cameras else ():
        points = marker_positions(cloud, context.scene.frame_current_final).values()
        centres = np.array([cloud.matrix_world @ Vector(point) for point in points])
    if not len(centres):
        return
    middle = centres.mean(axis=0)
    space.region_3d.view_perspective = "PERSP"
    space.region_3d.view_location = (middle[0], middle[1], middle[2] / 2)
    space.region_3d.view_distance = 1.5 * float(np.linalg.norm(centres - middle, axis=1).max()) + 2.0


def frame_body(context: bpy.types.Context, armature: bpy.types.Object) -> None:
    """Frame a new body in the viewport, unless the viewport looks through a camera."""
    space, skin = context.space_data, body_mesh(armature)
    if space is None or space.type != "VIEW_3D" or space.region_3d.view_perspective == "CAMERA" or skin is None:
        return
    space.region_3d.view_location = armature.matrix_world @ armature.pose.bones[JOINTS[0]].head
    space.region_3d.view_distance = _HEIGHTS * max(skin.dimensions)


def _take_people(capture: bpy.types.PropertyGroup, people: list[PersonSummary]) -> None:
    names = {person.key: person.name for person in capture.people}
    while len(capture.people) > len(people) if len(people) > 1 else len(capture.people):
        capture.people.remove(len(capture.people) - 1)
    for index, person in enumerate(people if len(people) > 1 else ()):
        item = capture.people[index] if index < len(capture.people) else capture.people.add()
        item.key, item.frames, item.views = person["name"], person["frames"], person["views"]
        item.name = names.get(item.key) or plain(item.key)


def take_motion(
    context: bpy.types.Context,
    files: SolveFiles,
    of: bpy.types.PropertyGroup | None = None,
    again: SolvedAgain | None = None,
    result: SolveResult | None = None,
    tell: Callable[[str], None] | None = None,
) -> bpy.types.Action:
    """Add a solved motion as a take to the body of its person, in the capture ``of`` or the current one.

    ``again`` is the frame range that was solved again. All other frames keep the user's edits. ``result`` contains the
    take's error and warnings. ``tell`` receives a sentence if one of the user's actions moves to the NLA.
    """
    scene, settings = context.scene, context.scene.mocap
    motion = read_motion(files.motion)
    body = read_body(body_path_of(motion.provenance), motion.body_layout)
    capture: bpy.types.PropertyGroup = settings.capture if of is None else of
    person = person_of(motion.provenance)
    index = capture.person_named(person)
    review = capture.review_of(index)
    who = f" {capture.people[index].name}" if capture.people else ""
    prefix = f"{capture.name if len(settings.captures) > 1 else ''}{who}".strip()
    name = f"{prefix} {files.motion.stem.replace('_', ' ').capitalize()}".strip()
    armature, start, parent = review.armature, capture.frame_start, capture.collection
    edited = None if again is None else bpy.data.actions.get(again.take)
    if edited is not None:
        start = int(edited["frame_start"])
    replaced, played = armature, [] if armature is None else playing_actions(armature)
    needs_body = armature is None or not armature.is_editable or not plays_body(armature, motion, body)
    with undisturbed(context) if needs_body else nullcontext():
        armature, action = add_take(scene, name, motion, body, armature, parent, start, who)
    if edited is not None and again is not None and not needs_body:
        action = keep_edits(scene, armature, edited, action, again.first, again.last)
    files.write(action)
    if person:
        action[PERSON] = person
    if result is not None:
        found = read_diagnostics(result.get("diagnostics"))
        action[ERROR], action[WARNINGS] = error_text(result), "\n".join(map(sentence, warnings_in(found)))
        action[DIAGNOSTICS] = findings_text(found)
    if tell is not None and replaced is not None and (note := aside_note(replaced, played)):
        tell(note)
    review.armature = armature
    settings.stage = "EDIT"
    if needs_body:
        _show_looks(scene)
        frame_body(context, armature)
    colour_markers(scene)
    if needs_body and replaced is not None:
        adopt_beside(scene, capture)
    bring_home()
    return action


def _show_looks(scene: bpy.types.Scene) -> None:
    for mesh in bodies_of(scene):
        show_look(mesh, scene.mocap.look)


def error_text(result: SolveResult) -> str:
    """Return the median error of a solve with its unit, or "" if the error is unknown."""
    for key, unit in (("marker_median_mm", "mm"), ("reprojection_median_px", "px")):
        if result.get(key) is not None:
            return f"{result[key]:.1f} {unit}"
    return ""


def add_motion(
    context: bpy.types.Context,
    file: Path,
    settings: BakeSettings,
    capture: Path | None = None,
    body: Path | None = None,
) -> BakedTake:
    """Add a motion file to the scene on a new body. In an untouched scene, also select this body."""
    motion = read_motion(file)
    figure = read_body(body or body_path_of(motion.provenance), motion.body_layout)
    source = read_capture(capture) if capture else None
    refused: tuple[str, ...] = ()
    if source is not None and capture is not None and not context.scene.mocap.reading.footage_anywhere:
        source, refused = near_footage(source, [capture.parent])
    with nullcontext() if settings.set_scene else undisturbed(context):
        take = bake_take(context.scene, motion, figure, source, settings)
    take = replace(take, notes=(*take.notes, *refused))
    page = file.with_suffix(".html")
    SolveFiles(file, capture, page if page.is_file() else None, None).write(take.action)
    if person := person_of(motion.provenance):
        take.action[PERSON] = person
    adopt(context.scene)
    _show_looks(context.scene)
    context.scene.mocap.stage = "EDIT"
    if settings.set_scene:
        for obj in context.selected_objects:
            obj.select_set(False)
        take.armature.select_set(True)
    return take


def takes_over(scene: bpy.types.Scene, setup: str) -> bool:
    """Return whether a scene takes its frame rate and range from the recording (see ``SCENE_SETUP``)."""
    return setup == "TAKE" or (setup == "NEW" and is_untouched(scene))


def set_up_said(scene: bpy.types.Scene, *, take_over: bool) -> str:
    """Return a sentence about the scene's frame rate and range after an import."""
    rate = f"{scene_frame_rate(scene):g} fps"
    if take_over:
        return f"The scene was set to {rate}, frames {scene.frame_start} to {scene.frame_end}"
    return f"The take is resampled to the scene's {rate}"
