"""All settings and data that the add-on stores in a scene, as ``scene.mocap``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import bpy

from .._exchange.diagnostics import notes_in, sentence, warnings_in
from .._exchange.errors import MocapError
from .._exchange.joint_sets import JointSet
from .._exchange.setting import defaults_of_class, settings_of_class
from .._exchange.solve_settings import PRESETS
from .._exchange.video_settings import DETECTORS, VideoSettings
from ..conventions.file_paths import file_of
from ..conventions.naming import MANNEQUIN, PERSON_LOOK, SEGMENTS_LOOK, SHAVEN_LOOK, SUIT_LOOK
from .acquisition_properties import MocapLive, MocapSensors, MocapStudio
from .capture_properties import MocapCapture, MocapReview
from .setting_properties import (
    CHOSEN_BY_PRESETS,
    DEFAULTS,
    ROWS,
    Items,
    ReadingProperties,
    SolveProperties,
    choice,
    items_of,
    listed,
    number,
    panel_values,
    path,
    properties_of,
    reading_options,
    switch,
    text,
)
from .tags import active_name, active_object

if TYPE_CHECKING:
    from ..retarget.rig_map import RigMap

AUTO = "AUTO"
STAGES = items_of("stage")
"""Workflow stages in order. The panels show one stage at a time."""
SCENE_SETUP = choice("Scene Set-Up", "Source of the scene's frame rate, range, resolution and camera", "scene_setup")
STEPS = {
    "detect": ("Keypoints", "Detect people in every image"),
    "sync": ("Sync", "Estimate the camera delays"),
    "calibrate": ("Calibration", "Calibrate the cameras with the board or the person"),
    "capture": ("Capture", "Combine the detections from all cameras, and check the fit"),
}
"""Label and description of each step from videos to a capture, in order."""
_UNITS = {"m": "Metres", "cm": "Centimetres", "mm": "Millimetres", "inch": "Inches"}
_UNIT_ITEMS = (
    (AUTO, "From the File", "Unit stated in the calibration"),
    *((unit, label, f"The calibration is in {label.lower()}") for unit, label in _UNITS.items()),
)
_UP_ITEMS = (
    (AUTO, "From the File", "Z, unless the format of the calibration uses another axis"),
    *((axis, axis.upper(), f"{axis.upper()} is up in the calibration") for axis in ("z", "y", "-y", "x", "-z", "-x")),
)
_JOINT_SET_ITEMS = (
    (AUTO, "Automatic", "Recognise the keypoint set from its size and bone lengths"),
    *((name, name.replace("COCO_WHOLEBODY", "Whole Body").replace("_", " "), f"{name} keypoints") for name in JointSet),
)


class MocapReading(ReadingProperties, bpy.types.PropertyGroup):
    """Settings of the Reading Options panel."""

    scene_setup: SCENE_SETUP
    footage_anywhere: switch(
        "Footage Anywhere", "Also load footage from outside the capture's folder (only for captures that you trust)"
    )
    joint_set: listed("joint_set", _JOINT_SET_ITEMS)
    unit: listed("unit", _UNIT_ITEMS)
    up_axis: listed("up_axis", _UP_ITEMS)

    def arguments(self) -> list[str]:
        """Return these settings as command-line options of the solver."""
        chosen = {name: getattr(self, name) for name in ("joint_set", "unit", "up_axis")}
        return reading_options(self, {name: value for name, value in chosen.items() if value != AUTO})


def _is_mesh(_self: bpy.types.PropertyGroup, obj: bpy.types.Object) -> bool:
    return obj.type == "MESH"


class MocapSolve(SolveProperties, bpy.types.PropertyGroup):
    """Settings of the Solve and Advanced panels."""

    preset: choice("Preset", "Choose settings by purpose instead of individually", "solve.preset", "BALANCED")
    subject: path("Subject", "Person file from Calibrate Subject (leave blank to calibrate the person from this take)")
    keep_shape: switch("Keep Shape", "Use the shape set by the body's sliders instead of estimating it", on=True)
    report: switch("Report", "Write an HTML page with errors, warnings and charts", on=True)
    contact_mesh: bpy.props.PointerProperty(
        type=bpy.types.Object,
        name="Contact Mesh",
        description="Stationary closed mesh that the body can touch but not enter, used instead of an objects file",
        poll=_is_mesh,
    )

    def acts(self, name: str) -> bool:
        """Return whether the chosen method uses a setting."""
        return ROWS[name].acts_in(self.method if self.preset == "CUSTOM" else DEFAULTS["method"])

    def values(self) -> dict[str, Any]:
        """Return the settings for a job file.

        They contain the method settings of the preset (or of the user), and all other settings that are not defaults.
        """
        acting = tuple(name for name in CHOSEN_BY_PRESETS if self.acts(name))
        method = panel_values(self, acting) if self.preset == "CUSTOM" else PRESETS[self.preset.lower()]
        others = panel_values(self, tuple(name for name in ROWS if name not in CHOSEN_BY_PRESETS))
        return method | {name: value for name, value in others.items() if value != DEFAULTS[name]}


class MocapVideoPicture(bpy.types.PropertyGroup):
    """An image that a step from videos created. The item's name is the image's path."""


class MocapVideoStep(bpy.types.PropertyGroup):
    """A finished step from videos to a capture. Its name is the solver's name for the step."""

    notes: str  # One sentence per line.
    warnings: str  # One sentence per line.
    pictures: Items[MocapVideoPicture]
    open: switch("Show", "Show the results and images of this step")


_DETECTORS = (
    *((name, detector.label, detector.description) for name, detector in DETECTORS.items()),
    ("model", "Model File", "RTMPose, RTMO, YOLO-pose or MoveNet (ONNX), MediaPipe (LiteRT), or a described model"),
)


class MocapVideos(
    properties_of(settings_of_class(VideoSettings), defaults_of_class(VideoSettings)), bpy.types.PropertyGroup
):
    """Settings for captures from videos, and the steps that are finished."""

    folder: path(
        "Videos",
        "Folder with one video per camera, and board footage in a 'calibration' subfolder",
        folder=True,
    )
    stature: number(
        "Stature",
        "Height of the person, which sets the scale without a board (0 is automatic: the mean height)",
        0.0,
        0,
        2.6,
        "m",
    )
    detector: choice("Detector", "Program that finds people in the videos", _DETECTORS)
    model: path("Model", "Pose model (.onnx or .tflite), or a .json file that describes one")
    hands: path("Hand Model", "MediaPipe's hand_landmark_full.tflite (leave blank to solve only the body)")
    fingers: switch("Fingers", "Find hands with the included detector and solve the fingers", on=True)
    results: str  # Folder that contains the detections, delays, calibration and capture.
    steps: Items[MocapVideoStep]

    def detector_arguments(self) -> list[str]:
        """Return the command-line options that choose the detector."""
        model = str(file_of(self.model)) if self.detector == "model" else self.detector
        return ["--detector", model, "--people", str(self.people)]

    def arguments(self) -> list[str]:
        """Return these settings as command-line options of the solver."""
        options = [*self.detector_arguments(), "--sync", self.clocks, "--cameras", self.cameras]
        options += ["--board", self.board] if self.board else []
        options += ["--lenses", str(file_of(self.lenses))] if self.lenses else []
        options += ["--focal", self.focal] if self.focal else []
        options += ["--hand-model", str(file_of(self.hands))] if self.hands else []
        return [*options, "--stature", f"{self.stature:.4f}"] if self.stature > 0 else options

    def take_steps(self, folder: str) -> None:
        """Show the steps that have results in a folder. Steps that the user has expanded stay expanded."""
        from ..solving.take_paths import read_road

        opened = {step.name for step in self.steps if step.open}
        self.steps.clear()
        for reported in read_road(Path(folder)):
            if reported.name in STEPS:
                step = self.steps.add()
                step.name, step.open = reported.name, reported.name in opened
                step.notes = "\n".join(map(sentence, notes_in(reported.diagnostics)))
                step.warnings = "\n".join(map(sentence, warnings_in(reported.diagnostics)))
                for picture in reported.pictures:
                    step.pictures.add().name = str(picture)


def _is_other_armature(self: bpy.types.PropertyGroup, obj: bpy.types.Object) -> bool:
    return obj.type == "ARMATURE" and obj not in (self.id_data.mocap.review.armature, self.actor)


def _is_other_than_target(self: bpy.types.PropertyGroup, obj: bpy.types.Object) -> bool:
    return obj.type == "ARMATURE" and obj != self.target


def _map_target(self: bpy.types.PropertyGroup, context: bpy.types.Context) -> None:
    from ..retarget.recognition import map_rig, user_presets_folder

    self.table.clear()
    self.label = self.map_text = self.warnings = ""
    try:
        if self.target is not None:
            show_map(self, map_rig(self.target, user_presets_folder()))
    except MocapError as error:  # one of the user's presets is damaged
        self.warnings = str(error)


def show_map(settings: bpy.types.PropertyGroup, rig_map: RigMap) -> None:
    """Fill the bone table with a map, one row for each body part."""
    import json

    from .._exchange.rigs.skeleton import JOINT_OF, order_of
    from ..retarget.rig_map import map_values

    settings.table.clear()
    settings.label, settings.map_text = rig_map.label, json.dumps(map_values(rig_map))
    settings.warnings = "\n".join(rig_map.doubts)
    for role in sorted({*rig_map.bones, *JOINT_OF}, key=order_of):
        row = settings.table.add()
        row.name, row.bone = role, rig_map.bones.get(role, "")


class MocapRole(bpy.types.PropertyGroup):
    """One row of the bone table: a body part and the rig's bone for it."""

    bone: text("Bone", "Bone of the target that matches this body part (leave blank if there is none)")


_ACTOR = {"type": bpy.types.Object, "name": "Actor", "poll": _is_other_than_target}
_TARGET = {"type": bpy.types.Object, "name": "Target", "poll": _is_other_armature, "update": _map_target}


def _set_automatic_scale(settings: bpy.types.PropertyGroup, on: bool) -> None:
    settings.scale = 0.0 if on else settings.scale or 1.0


class MocapRetarget(bpy.types.PropertyGroup):
    """Settings of the Retarget panel, and its bone table."""

    actor: bpy.props.PointerProperty(
        description="Armature that provides the motion (leave blank to use the solved body)", **_ACTOR
    )
    target: bpy.props.PointerProperty(description="Armature that receives the motion", **_TARGET)
    limbs: choice("Limbs", "Controls that drive the rig after retargeting (both sets get keys)", "retarget.limbs")
    way: choice("Root Motion", "Bone that receives the motion over the ground", "retarget.way")
    scale: number(
        "Scale",
        "Scale factor for the motion over the ground (0 is automatic: the ratio of the leg lengths)",
        0.0,
        0,
        1000,
        soft_max=10,
    )
    automatic_scale: switch(
        "Automatic Scale",
        "Scale the motion over the ground by the ratio of the leg lengths",
        on=True,
        get=lambda settings: not settings.scale,
        set=_set_automatic_scale,
    )
    label: str  # Name of the preset that the table shows.
    table: Items[MocapRole]
    warnings: str  # One sentence per line.
    map_text: str  # JSON text of the whole map, including its switches and map pose.


def _show_look(settings: bpy.types.PropertyGroup, context: bpy.types.Context) -> None:
    from ..body.looks import bodies_of, show_look  # they need NumPy, which registering must not load

    for mesh in bodies_of(settings.id_data):
        show_look(mesh, settings.look)


_LOOKS = (
    (PERSON_LOOK, "Athletic Wear", "Shirt, shorts, shoes and short hair"),
    (SHAVEN_LOOK, "Shaven Head", "Athletic wear without hair"),
    (SUIT_LOOK, "Suit", "A tight suit without hair, with exactly the skin that the solver uses"),
    (MANNEQUIN, "Mannequin", "A grey figure with marked joints and no face"),
    (SEGMENTS_LOOK, "Segments", "One colour per body segment, with the left side in blue and the right side in orange"),
)


class MocapSettings(bpy.types.PropertyGroup):
    """All of the add-on's settings and data in one scene."""

    folder: path(
        "Folder", "Folder for captures and takes (leave blank to use 'mocap' next to the .blend file)", folder=True
    )
    exported: str  # Description of the files and the folder of the last export.
    session: str  # Folder of the takes until the scene is saved.
    look: choice("Look", "Clothing or colours of all bodies in this scene", _LOOKS, update=_show_look)
    stage: choice("Stage", "Group of panels to show", STAGES)
    reading: MocapReading
    captures: Items[MocapCapture]
    blank: MocapCapture
    shown: int  # Index of the capture that was last imported or chosen.
    shown_active: str  # Name of the object that was active when ``shown`` was set.
    held: int = -1  # Index of the capture that the current solve belongs to.
    solve: MocapSolve
    live: MocapLive
    sensors: MocapSensors
    retarget: MocapRetarget
    videos: MocapVideos
    studio: MocapStudio

    @property
    def capture_index(self) -> int:
        """Index of the active object's capture, or else of the capture chosen last. -1 without captures."""
        last = len(self.captures) - 1
        if self.held >= 0:
            return min(self.held, last)
        active = active_object(self.id_data)
        if active is not None and active.name_full != self.shown_active:
            for index, capture in enumerate(self.captures):
                if capture.owns(active):
                    return index
        return min(self.shown, last)

    @property
    def capture(self) -> MocapCapture:
        """The current capture, or an empty capture if there is none."""
        index = self.capture_index
        return self.blank if index < 0 else self.captures[index]

    @property
    def review(self) -> MocapReview:
        """Review of the current person in the current capture."""
        return self.capture.review_of(self.capture.person_index)

    def show(self, index: int) -> None:
        """Make a capture the current one until an object from another capture becomes active."""
        self.shown, self.shown_active = index, active_name(self.id_data)
