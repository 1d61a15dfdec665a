"""Importing a capture: by button, by menu, by dropping a file on the viewport."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
import numpy as np
from bpy_extras.io_utils import ImportHelper

from ..bake.capture_stage import CaptureStage, set_stage
from ..errors import AddonError
from ..files.arrays import read_arrays, text
from ..files.capture_file import read_capture
from ..files.motion_file import FORMAT as MOTION_FORMAT
from ..solving.places import capture_folder, capture_root
from .following import FollowsRun
from .locations import files_folder


class MOCAP_OT_import_capture(FollowsRun, bpy.types.Operator, ImportHelper):
    """Reads a capture in the solver's process and sets up its cameras, footage and detections."""

    bl_idname = "mocap.import_capture"
    bl_label = "Import Capture"
    bl_description = (
        "Read a capture, say what was recognised, and add its cameras, footage, detections and floor. "
        "Choose a folder (a Pose2Sim trial, or folders of OpenPose JSON with a calibration) or any file in it"
    )
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender reads a plain set

    filter_glob: bpy.props.StringProperty(default="*.npz;*.json;*.toml;*.qca.txt", options={"HIDDEN"})
    directory: bpy.props.StringProperty(subtype="DIR_PATH", options={"HIDDEN", "SKIP_SAVE"})
    files: bpy.props.CollectionProperty(type=bpy.types.OperatorFileListElement, options={"HIDDEN", "SKIP_SAVE"})

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Read what was dropped, or let the user choose."""
        if self.files or (self.filepath and Path(self.filepath).exists()):
            return self.execute(context)
        return ImportHelper.invoke(self, context, event)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Start reading; a solved motion is baked at once instead."""
        chosen = self._chosen()
        if _is_motion(chosen):
            return bpy.ops.mocap.import_motion(filepath=str(chosen))
        settings = context.scene.mocap
        try:
            source = capture_root(chosen)
            folder = capture_folder(files_folder(context.scene), source)
            folder.mkdir(exist_ok=True)
            arguments = [
                str(source),
                "--out",
                str(folder / "capture.npz"),
                "--overwrite",
                *settings.reading.arguments(),
            ]
            settings.capture.source = str(source)
            return self.launch(context, "convert", arguments, folder)
        except AddonError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}

    def _chosen(self) -> Path:
        """Return the first file that was dropped, or what was chosen: a file or a folder."""
        if self.files and self.files[0].name:
            return Path(bpy.path.abspath(self.directory)) / self.files[0].name
        return Path(bpy.path.abspath(self.filepath or self.directory))

    def received(self, context: bpy.types.Context, result: dict[str, Any]) -> set[str]:
        """Set the stage, and keep what was recognised for the panels."""
        stage = take_capture(context.scene, result)
        frame_capture(context, stage)
        problems = len(result["problems"])
        found = f"{len(stage.cameras)} cameras, {result['frames']} frames"
        self.report(
            {"WARNING"} if problems else {"INFO"},
            f"Capture '{result['name']}': {found}" + (f"; {problems} problems, see the panel" if problems else ""),
        )
        return {"FINISHED"}


class MOCAP_OT_demo_capture(FollowsRun, bpy.types.Operator):
    """Makes the capture that ships with the add-on."""

    bl_idname = "mocap.demo_capture"
    bl_label = "Try the Demo Capture"
    bl_description = "Make a synthetic capture of a walking person and set it up: nothing of your own is needed"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender reads a plain set

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Start making it."""
        try:
            folder = capture_folder(files_folder(context.scene), Path("demo"))
            folder.mkdir(exist_ok=True)
            return self.launch(context, "demo-capture", ["--out", str(folder / "capture.npz"), "--overwrite"], folder)
        except AddonError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}

    def received(self, context: bpy.types.Context, result: dict[str, Any]) -> set[str]:
        """Set the stage."""
        context.scene.mocap.capture.source = result["capture"]
        frame_capture(context, take_capture(context.scene, result))
        return {"FINISHED"}


def take_capture(scene: bpy.types.Scene, result: dict[str, Any]) -> CaptureStage:
    """Set up a capture the solver has read, and keep what it said in the scene's settings.

    Args:
        scene: the scene.
        result: result event of the verb ``convert``.

    Raises:
        AddonError: the capture file is missing or wrong.
    """
    file = read_capture(Path(result["capture"]))
    capture = scene.mocap.capture
    stage = set_stage(scene, file, frame_start=scene.frame_start)
    scene.mocap.review.armature = None
    capture.name, capture.file = result["name"], result["capture"]
    capture.frames, capture.fps, capture.frame_start = result["frames"], result["fps"], scene.frame_start
    capture.joint_set, capture.markers = result["joint_set"] or "", result["markers"] or 0
    capture.collection, capture.floor = stage.collection, stage.floor
    capture.messages.clear()
    sentences = [(text, True) for text in (*result["problems"], *stage.notes)] + [(t, False) for t in result["notes"]]
    for sentence, is_problem in sentences:
        message = capture.messages.add()
        message.text, message.is_problem = sentence, is_problem
    capture.cameras.clear()
    views = {overlay.parent: overlay for overlay in stage.overlays if overlay.parent is not None}
    for camera, said in zip(stage.cameras, result["cameras"], strict=True):
        item = capture.cameras.add()
        item.name, item.object, item.detections = said["name"], camera, views.get(camera)
        item.seen_percent = said["seen_percent"] or 0.0
        item.has_footage = bool(camera.data.background_images)
    review = scene.mocap.review
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


class MOCAP_FH_capture(bpy.types.FileHandler):
    """Takes files that are dropped on the 3D viewport."""

    bl_idname = "MOCAP_FH_capture"
    bl_label = "Motion capture"
    bl_import_operator = "mocap.import_capture"
    bl_file_extensions = ".npz;.json;.toml"

    @classmethod
    def poll_drop(cls, context: bpy.types.Context) -> bool:
        """Only in the 3D viewport."""
        return context.area is not None and context.area.type == "VIEW_3D"


def draw_import_menu(self: bpy.types.Menu, context: bpy.types.Context) -> None:
    """Draw the entry in File > Import."""
    self.layout.operator(MOCAP_OT_import_capture.bl_idname, text="Motion Capture (.npz, folder)")


def _is_motion(path: Path) -> bool:
    if path.suffix.lower() != ".npz":
        return False
    try:
        arrays = read_arrays(path, required=(), optional=("format", "poses"))
    except AddonError:
        return False  # the solver's process says what is wrong with it
    return text(arrays, "format") == MOTION_FORMAT or ("poses" in arrays and "format" not in arrays)
