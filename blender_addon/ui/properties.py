"""What the add-on keeps in a scene, under one pointer: ``scene.mocap``."""

from __future__ import annotations

from typing import Any

import bpy

from .._exchange.joint_sets import JointSet
from .._exchange.vmc.address import VmcAddress
from ..conventions.naming import MANNEQUIN, PERSON_LOOK
from ..solving.presets import PRESETS
from .capture_properties import CAPTURE_CLASSES, MocapCapture, MocapReview
from .locations import RELATIVE
from .retarget_properties import MocapRetarget
from .rig_properties import RIG_CLASSES, MocapRig
from .sending_properties import SendingProperties
from .setting_properties import (
    CHOSEN_BY_PRESETS,
    DEFAULTS,
    ROWS,
    ReadingProperties,
    SettingProperties,
    panel_values,
    reading_options,
    words_of,
)
from .studio_properties import MocapStudio
from .tags import active_name, active_object
from .video_properties import VIDEO_CLASSES, MocapVideos

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
_FORMER_JOINT_SETS = ("BODY_25", "BODY_25B", "COCO_17", "COCO_WHOLEBODY_133", "HALPE_26", "MEDIAPIPE_33", "H36M_17")
"""First in the list: Blender's files keep a choice by its place."""
_JOINT_SET_ITEMS = (
    (AUTO, "As Recognised", "Recognised by the number of keypoints and by anatomy"),
    *(
        (name, name.replace("COCO_WHOLEBODY", "Whole Body").replace("_", " "), f"Keypoints are {name}'s")
        for name in dict.fromkeys((*_FORMER_JOINT_SETS, *JointSet))
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


CLASSES = (*CAPTURE_CLASSES, *VIDEO_CLASSES, *RIG_CLASSES, MocapReading, MocapSolve, MocapLive, MocapSettings)
"""In the order of registration: what is pointed to comes first."""
