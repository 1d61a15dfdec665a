"""What the add-on keeps in a scene, under one pointer: ``scene.mocap``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import bpy

from .._exchange.detectors import DETECTORS
from .._exchange.errors import MocapError
from .._exchange.joint_sets import JointSet
from .._exchange.video_settings import DEFAULTS as VIDEO_DEFAULTS
from .._exchange.video_settings import ROWS as VIDEO_ROWS
from .._exchange.vmc.address import VmcAddress
from ..conventions.naming import MANNEQUIN, PERSON_LOOK
from ..solving.presets import PRESETS
from .acquisition_properties import MocapRig, MocapStudio, SendingProperties
from .capture_properties import MocapCapture, MocapReview
from .project_files import RELATIVE
from .setting_properties import (
    CHOSEN_BY_PRESETS,
    DEFAULTS,
    ROWS,
    ReadingProperties,
    SettingProperties,
    make_property,
    panel_values,
    reading_options,
    words_of,
)
from .tags import active_name, active_object

if TYPE_CHECKING:
    from ..retarget.rig_map import RigMap

STEPS = {
    "detect": ("Keypoints", "Find the person in every picture"),
    "sync": ("Sync", "Find how far cameras are ahead or late"),
    "calibrate": ("Calibration", "Find where the cameras stand, from the board or the person"),
    "capture": ("Capture", "Assemble what all cameras saw, and check the fit"),
}
"""Name and description of each step, in their order."""
_DETECTOR_ITEMS = (
    *((name, detector.label, detector.description) for name, detector in DETECTORS.items()),
    ("model", "Model File", "RTMPose, RTMO, YOLO-pose or MoveNet (ONNX), or MediaPipe's pose model for LiteRT"),
)


class MocapVideoPicture(bpy.types.PropertyGroup):
    """One picture of a step; its name is its path."""


class MocapVideoStep(bpy.types.PropertyGroup):
    """One step that is done; its name is the solver's."""

    words: bpy.props.StringProperty(name="Words", description="What it found, a sentence a line")
    doubts: bpy.props.StringProperty(name="Doubts", description="What is wrong or unsure, a sentence a line")
    pictures: bpy.props.CollectionProperty(type=MocapVideoPicture)
    open: bpy.props.BoolProperty(name="Show", description="Show what this step found, and its picture", default=False)


def made(name: str) -> Any:
    """Return the property of a setting of videos."""
    return make_property(VIDEO_ROWS[name], VIDEO_DEFAULTS[name])


class MocapVideos(bpy.types.PropertyGroup):
    """How captures are made from videos, and the steps of the last one."""

    folder: bpy.props.StringProperty(
        name="Videos", subtype="DIR_PATH", options=RELATIVE,
        description="Folder of a take: one video a camera; footage of a board in 'calibration' beside them",
    )  # fmt: skip
    results: bpy.props.StringProperty(
        name="Results", subtype="DIR_PATH", options=RELATIVE,
        description="Where detections, clocks, calibration and capture of these videos are kept",
    )  # fmt: skip
    cameras: made("cameras")
    board: made("board")
    lenses: made("lenses")
    focal: made("focal")
    stature: bpy.props.FloatProperty(
        name="Stature", description="Stature of the person, which sets the scale without a board; 0 for the mean",
        unit="LENGTH", min=0.0, max=2.6, precision=2,
    )  # fmt: skip
    detector: bpy.props.EnumProperty(name="Detector", description="What finds keypoints", items=_DETECTOR_ITEMS)
    model: bpy.props.StringProperty(
        name="Model", description="File of a pose model, .onnx or .tflite", subtype="FILE_PATH", options=RELATIVE
    )
    hands: bpy.props.StringProperty(
        name="Hand Model", subtype="FILE_PATH", options=RELATIVE,
        description="MediaPipe's hand_landmark_full.tflite, to find hands and solve fingers; empty for the body alone",
    )  # fmt: skip
    people: made("people")
    sync: made("clocks")
    steps: bpy.props.CollectionProperty(type=MocapVideoStep)

    def detector_arguments(self) -> list[str]:
        """Return the options of the solver's command line that choose the detector."""
        from ..conventions.file_paths import file_of

        model = str(file_of(self.model)) if self.detector == "model" else self.detector
        return ["--detector", model, "--people", str(self.people)]

    def arguments(self) -> list[str]:
        """Return the options of the solver's command line."""
        from ..conventions.file_paths import file_of

        options = [*self.detector_arguments(), "--sync", self.sync, "--cameras", self.cameras]
        options += ["--board", self.board] if self.board else []
        options += ["--lenses", str(file_of(self.lenses))] if self.lenses else []
        options += ["--focal", self.focal] if self.focal else []
        options += ["--hand-model", str(file_of(self.hands))] if self.hands else []
        return [*options, "--stature", f"{self.stature:.4f}"] if self.stature > 0 else options

    def take_steps(self, folder: str) -> None:
        """Show the steps whose results lie in a folder, those that were open open again."""
        from pathlib import Path

        from .._exchange.diagnostics import notes_in, sentence, warnings_in
        from ..solving.road_file import read_road

        opened = {step.name for step in self.steps if step.open}
        self.steps.clear()
        for reported in read_road(Path(folder)):
            if reported.name in STEPS:
                step = self.steps.add()
                step.name, step.open = reported.name, reported.name in opened
                step.words = "\n".join(map(sentence, notes_in(reported.diagnostics)))
                step.doubts = "\n".join(map(sentence, warnings_in(reported.diagnostics)))
                for picture in reported.pictures:
                    step.pictures.add().name = str(picture)


def _is_other_armature(self: bpy.types.PropertyGroup, obj: bpy.types.Object) -> bool:
    return obj.type == "ARMATURE" and obj not in (self.id_data.mocap.review.armature, self.actor)


def _is_other_than_target(self: bpy.types.PropertyGroup, obj: bpy.types.Object) -> bool:
    return obj.type == "ARMATURE" and obj != self.target


def _map_target(self: bpy.types.PropertyGroup, context: bpy.types.Context) -> None:
    """Map the target that was chosen, where its bones show what they are."""
    from ..retarget.recognition import map_rig, user_presets_folder

    self.table.clear()
    self.label = self.map_text = self.doubts = ""
    try:
        if self.target is not None:
            show_map(self, map_rig(self.target, user_presets_folder()))
    except MocapError as error:  # a preset of the user's that is damaged
        self.doubts = str(error)


def show_map(settings: bpy.types.PropertyGroup, rig_map: RigMap) -> None:
    """Write a map into the table, with a row for every role that a person can fill."""
    import json

    from .._exchange.rigs.roles import JOINT_OF, order_of
    from ..retarget.rig_map import map_values

    settings.table.clear()
    settings.label, settings.map_text = rig_map.label, json.dumps(map_values(rig_map))
    settings.doubts = "\n".join(rig_map.doubts)
    for role in sorted({*rig_map.bones, *JOINT_OF}, key=order_of):
        row = settings.table.add()
        row.name, row.bone = role, rig_map.bones.get(role, "")


class MocapRole(bpy.types.PropertyGroup):
    """One row of the table: a role and the bone that plays it."""

    bone: bpy.props.StringProperty(name="Bone", description="Bone of the rig that plays this role; empty for none")


class MocapRetarget(bpy.types.PropertyGroup):
    """How to retarget."""

    actor: bpy.props.PointerProperty(
        type=bpy.types.Object, name="Actor", description="Armature that has the motion; empty for the solved body",
        poll=_is_other_than_target,
    )  # fmt: skip
    target: bpy.props.PointerProperty(
        type=bpy.types.Object, name="Target", description="Armature of the character that gets the motion",
        poll=_is_other_armature, update=_map_target,
    )  # fmt: skip
    label: bpy.props.StringProperty(name="Map", description="Preset that the table came from")
    table: bpy.props.CollectionProperty(type=MocapRole, name="Table", description="Which bone plays which role")
    doubts: bpy.props.StringProperty(name="Doubts", description="What is uncertain about the map, a line each")
    map_text: bpy.props.StringProperty(name="Map Text", description="The whole map, its switches and map pose included")
    limbs: bpy.props.EnumProperty(
        name="Limbs", description="What the rig's switches are set to; both sets of controls are keyed",
        items=(
            ("fk", "FK", "Limbs turn bone by bone: twist as the actor's"),
            ("ik", "IK", "Hands and feet are posed: easiest to edit, elbows and knees bend as pure hinges"),
        ),
    )  # fmt: skip
    way: bpy.props.EnumProperty(
        name="Root Motion", description="What carries the travel over the ground",
        items=(
            ("body", "On Hips", "The hips carry it"),
            ("root", "On Root", "The root bone carries it and the heading, smoothed"),
            ("place", "In Place", "It is left out"),
        ),
    )  # fmt: skip
    scale: bpy.props.FloatProperty(
        name="Scale", min=0.0, soft_max=10.0,
        description="Scale of the travel relative to the body's; 0 for the ratio of the legs",
    )  # fmt: skip


STAGES = (
    ("CAPTURE", "Capture", "Read a recording, and look at what was recognised"),
    ("SOLVE", "Solve", "Solve the capture into a take"),
    ("EDIT", "Edit", "Review the take, correct it and clean it up"),
    ("DELIVER", "Deliver", "Export the take, or retarget it to a character"),
)
"""The stages of the work, in their order; the panels of one are shown at a time."""
_LOOK_ITEMS = (
    (PERSON_LOOK, "Person", "Skin, suit, and a face"),
    (MANNEQUIN, "Mannequin", "One colour, and no face"),
)
AUTO = "AUTO"
_PRESET_ITEMS = (
    ("FAST", "Fast", "Keys farther apart, a third less time: for a first look"),
    ("BALANCED", "Balanced", "The solver's own settings: for most takes"),
    ("BEST", "Best", "Keys closer together: for dance, sports and other fast limbs"),
    ("CUSTOM", "Custom", "The settings below"),
)
_UNIT_ITEMS = (
    (AUTO, "From the File", "As stated in the calibration"),
    ("m", "Metres", "Lengths of the calibration are metres"),
    ("cm", "Centimetres", "Lengths of the calibration are centimetres"),
    ("mm", "Millimetres", "Lengths of the calibration are millimetres"),
    ("inch", "Inches", "Lengths of the calibration are inches"),
)
_UP_ITEMS = (
    (AUTO, "From the File", "Z, unless the calibration's format has another axis"),
    *(
        (axis, axis.upper(), f"The calibration's world has {axis.upper()} up")
        for axis in ("z", "y", "-y", "x", "-z", "-x")
    ),
)
_JOINT_SET_ITEMS = (
    (AUTO, "As Recognised", "Recognised by the number of keypoints and by anatomy"),
    *(
        (name, name.replace("COCO_WHOLEBODY", "Whole Body").replace("_", " "), f"Keypoints are {name}'s")
        for name in JointSet
    ),
)


SCENE_SETUP_ITEMS = (
    ("NEW", "New Scenes Alone", "Set up a new scene; keep the settings of any other"),
    ("KEEP", "The Shot's", "Keep frame rate, range, resolution and camera; the recording is laid by time"),
    ("TAKE", "The Recording's", "Set the scene to the recording's frame rate, length, resolution and first camera"),
)


_LIVE_ITEMS = (
    ("FILE", "Recording", "A recording of markers, or a motion, replayed at its own rate"),
    ("VMC", "Another Program", "Poses by the VMC protocol, or a face from Live Link Face or iFacialMocap on a phone"),
    ("CAMERAS", "Cameras", "Two to four calibrated cameras that film a person without markers, or videos of them"),
)


class MocapReading(ReadingProperties, bpy.types.PropertyGroup):
    """How a capture is read."""

    joint_set: bpy.props.EnumProperty(**words_of("joint_set"), items=_JOINT_SET_ITEMS)
    unit: bpy.props.EnumProperty(**words_of("unit"), items=_UNIT_ITEMS)
    up_axis: bpy.props.EnumProperty(**words_of("up_axis"), items=_UP_ITEMS)
    scene_setup: bpy.props.EnumProperty(
        name="Scene Set-Up", description="Whose frame rate, range, resolution and camera count", items=SCENE_SETUP_ITEMS
    )
    footage_anywhere: bpy.props.BoolProperty(
        name="Footage Anywhere",
        description="Look for footage wherever the capture names it, on other machines too; without, only in the "
        "folder of the capture. Tick it for captures you trust",
    )

    def arguments(self) -> list[str]:
        """Return the options of the solver's command line."""
        listed = {name: getattr(self, name) for name in ("joint_set", "unit", "up_axis")}
        return reading_options(self, {name: value for name, value in listed.items() if value != AUTO})


class MocapSolve(SettingProperties, bpy.types.PropertyGroup):
    """How to solve."""

    preset: bpy.props.EnumProperty(
        name="Preset", description="What the solve is for", items=_PRESET_ITEMS, default="BALANCED"
    )
    subject: bpy.props.StringProperty(
        name="Subject", subtype="FILE_PATH", options=RELATIVE,
        description="Calibrated person who wears the markers; empty to learn shape and places from the take itself",
    )  # fmt: skip
    keep_shape: bpy.props.BoolProperty(
        name="Keep Shape",
        description="Solve with the shape that the body's sliders show; otherwise the shape is estimated",
        default=True,
    )
    report: bpy.props.BoolProperty(name="Report", description="Write a page about the solve", default=True)

    def acts(self, name: str) -> bool:
        """Return whether a setting does anything in the method that is chosen; presets have the solver's own."""
        return ROWS[name].acts_in(self.method if self.preset == "CUSTOM" else DEFAULTS["method"])

    def values(self) -> dict[str, Any]:
        """Return the job file's settings: those of the preset or one's own, and what else is not as it ships."""
        acting = tuple(name for name in CHOSEN_BY_PRESETS if self.acts(name))
        method = panel_values(self, acting) if self.preset == "CUSTOM" else PRESETS[self.preset]
        others = panel_values(self, tuple(name for name in ROWS if name not in CHOSEN_BY_PRESETS))
        return method | {name: value for name, value in others.items() if value != DEFAULTS[name]}


class MocapLive(SendingProperties, bpy.types.PropertyGroup):
    """What a live run is started with."""

    kind: bpy.props.EnumProperty(name="Source", description="Where points or poses come from", items=_LIVE_ITEMS)
    source: bpy.props.StringProperty(
        name="Recording", subtype="FILE_PATH", options=RELATIVE,
        description="Recording of markers (C3D, TRC, CSV, TSV) or motion (.npz) to replay at its own rate; empty for "
        "the capture's own markers",
    )  # fmt: skip
    listen: bpy.props.StringProperty(
        name="Listen At", default=str(VmcAddress()),
        description="Address of this machine that the other program sends to; vmc://0.0.0.0 hears the network, too. "
        "For a face livelink://0.0.0.0, or ifacialmocap:// with the phone's address",
    )  # fmt: skip
    cameras: bpy.props.StringProperty(
        name="Cameras",
        description="Two to four with blanks between: webcam:0, oak:ID or a video's path; NAME=webcam:0 names the "
        "calibration's camera",
    )  # fmt: skip
    calibration: bpy.props.StringProperty(
        name="Calibration", subtype="FILE_PATH", options=RELATIVE, description="Calibration of the cameras"
    )
    subject: bpy.props.StringProperty(
        name="Subject", subtype="FILE_PATH", options=RELATIVE,
        description="Calibrated person; empty to learn the shape while they move",
    )  # fmt: skip
    record: bpy.props.BoolProperty(
        name="Record", description="Keep the points as a take to be solved, or the poses as a motion", default=True
    )
    drive: bpy.props.BoolProperty(
        name="Drive Character", description="Let a character's rig, the Retarget panel's target, move as the body does"
    )
    face_mesh: bpy.props.StringProperty(
        name="Face", description="Mesh whose shape keys follow the face of the other program, as long as it is live"
    )
    face_table: bpy.props.StringProperty(
        name="Face Table", subtype="FILE_PATH", options=RELATIVE,
        description="JSON file with the shape key of each channel; empty where they have the same names",
    )  # fmt: skip


def _show_look(settings: bpy.types.PropertyGroup, context: bpy.types.Context) -> None:
    from ..body.looks import bodies_of, show_look  # which need NumPy; registering must not

    for mesh in bodies_of(settings.id_data):
        show_look(mesh, settings.look)


class MocapSettings(bpy.types.PropertyGroup):
    """Everything of one scene."""

    folder: bpy.props.StringProperty(
        name="Folder", subtype="DIR_PATH", options=RELATIVE,
        description="Where captures and takes are written; empty for 'mocap' beside the .blend file",
    )  # fmt: skip
    session: bpy.props.StringProperty(
        name="Session Folder", description="Where the takes of this unsaved scene wait until it is saved"
    )
    look: bpy.props.EnumProperty(
        name="Look", description="What the bodies of this scene look like", items=_LOOK_ITEMS, update=_show_look
    )
    stage: bpy.props.EnumProperty(name="Stage", description="Which panels are shown", items=STAGES)
    reading: bpy.props.PointerProperty(type=MocapReading)
    captures: bpy.props.CollectionProperty(type=MocapCapture)
    blank: bpy.props.PointerProperty(type=MocapCapture)
    shown: bpy.props.IntProperty(name="Shown Capture", description="Capture that was imported or chosen last")
    shown_active: bpy.props.StringProperty(name="Active Object when it was chosen")
    held: bpy.props.IntProperty(name="Held Capture", description="Capture that a finished run belongs to", default=-1)
    solve: bpy.props.PointerProperty(type=MocapSolve)
    live: bpy.props.PointerProperty(type=MocapLive)
    rig: bpy.props.PointerProperty(type=MocapRig)
    retarget: bpy.props.PointerProperty(type=MocapRetarget)
    videos: bpy.props.PointerProperty(type=MocapVideos)
    studio: bpy.props.PointerProperty(type=MocapStudio)

    @property
    def capture_index(self) -> int:
        """Return which capture panels and operators are about, -1 where there is none.

        That is the one the active object belongs to; the one imported or chosen last, until another object is active.
        """
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
        """The capture that panels and operators are about, an empty one where there is none."""
        index = self.capture_index
        return self.blank if index < 0 else self.captures[index]

    @property
    def review(self) -> MocapReview:
        """What is looked at of that capture, of one person where it shows several."""
        return self.capture.review_of(self.capture.person_index)

    def show(self, index: int) -> None:
        """Let panels be about a capture until an object of another one is made active."""
        self.shown, self.shown_active = index, active_name(self.id_data)
