"""What the add-on keeps in a scene, under one pointer: ``scene.mocap``."""

from __future__ import annotations

from typing import Any

import bpy

from ..solving.presets import PRESETS
from .locations import RELATIVE

AUTO = "AUTO"
_PRESET_ITEMS = (
    ("FAST", "Fast", "Keys farther apart, a third less time: for a first look"),
    ("BALANCED", "Balanced", "The solver's own settings: for most takes"),
    ("BEST", "Best", "Keys closer together: for dance, sports and other fast limbs"),
    ("CUSTOM", "Custom", "The settings below"),
)
_METHOD_ITEMS = (
    ("global", "Whole Take", "All keyframes of the take at once"),
    ("sliding", "Sliding Window", "Window after window, as published: for very long takes and for comparison"),
    ("frame", "Frame by Frame", "Every frame on its own: for single poses and for comparison"),
)
_BACKEND_ITEMS = (
    ("numpy", "NumPy", "Works everywhere"),
    ("torch", "PyTorch", "Needs a Python with torch, chosen in the add-on's preferences"),
)
_UNIT_ITEMS = (
    (AUTO, "As the File Says", "Told from the calibration"),
    ("m", "Metres", "Lengths of the calibration are metres"),
    ("cm", "Centimetres", "Lengths of the calibration are centimetres"),
    ("mm", "Millimetres", "Lengths of the calibration are millimetres"),
    ("inch", "Inches", "Lengths of the calibration are inches"),
)
_UP_ITEMS = (
    (AUTO, "As the File Says", "Z, unless the calibration's format has another axis"),
    *(
        (axis, axis.upper(), f"The calibration's world has {axis.upper()} up")
        for axis in ("z", "y", "-y", "x", "-z", "-x")
    ),
)
_JOINT_SET_ITEMS = (
    (AUTO, "As Recognised", "Told from the number of keypoints and from anatomy"),
    *(
        (name, name.replace("_", " "), f"Keypoints are {name}'s")
        for name in ("BODY_25", "BODY_25B", "COCO_17", "COCO_WHOLEBODY_133", "HALPE_26", "MEDIAPIPE_33", "H36M_17")
    ),
)


class MocapMessage(bpy.types.PropertyGroup):
    """One sentence about a capture."""

    text: bpy.props.StringProperty(name="Text")
    is_problem: bpy.props.BoolProperty(name="Problem")


class MocapCamera(bpy.types.PropertyGroup):
    """One camera of the capture."""

    seen_percent: bpy.props.FloatProperty(
        name="Seen", description="Share of the keypoints it sees", subtype="PERCENTAGE"
    )
    has_footage: bpy.props.BoolProperty(name="Footage", description="Footage was found")
    object: bpy.props.PointerProperty(type=bpy.types.Object, name="Camera")
    detections: bpy.props.PointerProperty(type=bpy.types.Object, name="Detections")


class MocapReading(bpy.types.PropertyGroup):
    """How a capture is read."""

    fps: bpy.props.FloatProperty(
        name="Frame Rate", description="Frames per second; 0 takes what the capture says", min=0, soft_max=240
    )
    joint_set: bpy.props.EnumProperty(name="Keypoints", description="What the keypoints are", items=_JOINT_SET_ITEMS)
    unit: bpy.props.EnumProperty(name="Unit", description="Length unit of the calibration", items=_UNIT_ITEMS)
    up_axis: bpy.props.EnumProperty(
        name="Up Axis", description="Axis of the calibration's world that points up", items=_UP_ITEMS
    )
    trim: bpy.props.BoolProperty(
        name="Cut to the Shortest", description="Cut cameras of different lengths to the frames all have"
    )

    def arguments(self) -> list[str]:
        """Return the options of the solver's command line."""
        options: list[str] = ["--fps", f"{self.fps:g}"] if self.fps > 0 else []
        for name in ("joint_set", "unit", "up_axis"):
            if (value := getattr(self, name)) != AUTO:
                options.append(f"--{name.replace('_', '-')}={value}")  # one word, as -y is no option
        return [*options, "--trim"] if self.trim else options


class MocapCapture(bpy.types.PropertyGroup):
    """The capture of this scene."""

    source: bpy.props.StringProperty(name="Source", description="File or folder it was read from", subtype="FILE_PATH")
    file: bpy.props.StringProperty(name="Capture File", description="Capture file made of it", subtype="FILE_PATH")
    name: bpy.props.StringProperty(name="Name")
    frames: bpy.props.IntProperty(name="Frames")
    fps: bpy.props.FloatProperty(name="Frame Rate")
    frame_start: bpy.props.IntProperty(name="First Frame", default=1)
    joint_set: bpy.props.StringProperty(name="Keypoints")
    markers: bpy.props.IntProperty(name="Markers")
    cameras: bpy.props.CollectionProperty(type=MocapCamera)
    messages: bpy.props.CollectionProperty(type=MocapMessage)
    collection: bpy.props.PointerProperty(type=bpy.types.Collection, name="Collection")
    floor: bpy.props.PointerProperty(type=bpy.types.Object, name="Floor")


CHOSEN_BY_PRESETS = (
    "method", "window", "refine_window", "residual_rotations", "contacts", "learn_noise", "iterations", "robust_scale",
)  # fmt: skip
"""Settings that are the user's own with the preset Custom alone."""


class MocapSolve(bpy.types.PropertyGroup):
    """How to solve."""

    preset: bpy.props.EnumProperty(
        name="Preset", description="What the solve is for", items=_PRESET_ITEMS, default="BALANCED"
    )
    method: bpy.props.EnumProperty(name="Method", description="How frames are tied together", items=_METHOD_ITEMS)
    window: bpy.props.IntProperty(
        name="Window",
        description="Frames at 60 a second between the ends of a window of keyframes",
        default=20,
        min=4,
        max=240,
    )
    refine_window: bpy.props.IntProperty(
        name="Refined Window", description="The same for the last passes; fewer follow faster limbs",
        default=10, min=2, max=240,
    )  # fmt: skip
    residual_rotations: bpy.props.BoolProperty(
        name="Free Joints", description="Let joints leave the manifold of learned poses a little", default=True
    )
    contacts: bpy.props.BoolProperty(
        name="Feet Stand", description="Hold feet that stand to where they stand", default=True
    )
    learn_noise: bpy.props.BoolProperty(
        name="Weigh Views", description="Learn how reliable each keypoint is in each view", default=True
    )
    iterations: bpy.props.IntProperty(
        name="Iterations", description="Linearisations at most for each robust step", default=8, min=1, max=200
    )
    robust_scale: bpy.props.FloatProperty(
        name="Outlier Scale", description="Standard deviations at which a detection starts to be doubted",
        default=4.0, min=0.1, max=100,
    )  # fmt: skip
    estimate_sync: bpy.props.BoolProperty(
        name="Correct Delays", description="Move each camera's detections by its estimated delay; without, only "
        "delays of two frames and more are corrected", default=False,
    )  # fmt: skip
    backend: bpy.props.EnumProperty(name="Arrays", description="What computes", items=_BACKEND_ITEMS)
    body: bpy.props.StringProperty(
        name="Body", description="Name of a body, or the path of a body file; empty for the one that ships"
    )
    keep_shape: bpy.props.BoolProperty(
        name="Keep Shape",
        description="Solve with the shape the body's sliders show; without it the shape is estimated anew",
        default=True,
    )
    report: bpy.props.BoolProperty(name="Report", description="Write a page about the solve", default=True)

    def values(self) -> dict[str, Any]:
        """Return the job file's settings."""
        chosen: dict[str, Any] = {"backend": self.backend} if self.backend != "numpy" else {}
        if self.estimate_sync:
            chosen["estimate_sync"] = True
        if self.body:
            chosen["body"] = self.body
        if self.preset != "CUSTOM":
            return {**PRESETS[self.preset], **chosen}
        return {**{name: getattr(self, name) for name in CHOSEN_BY_PRESETS}, **chosen}


class MocapPin(bpy.types.PropertyGroup):
    """A pose the solver must keep."""

    frame: bpy.props.IntProperty(name="Frame", description="Scene frame")
    job_values: bpy.props.StringProperty(name="Pose", description="The pose as it stands in the job file")


def _recolour(self: bpy.types.PropertyGroup, context: bpy.types.Context) -> None:
    from .bone_colours import colour_bones

    colour_bones(context.scene)


class MocapReview(bpy.types.PropertyGroup):
    """What is looked at."""

    armature: bpy.props.PointerProperty(type=bpy.types.Object, name="Body", description="Armature of the solved body")
    colours: bpy.props.BoolProperty(
        name="Colour Bones",
        description="Paint each bone by its joint's confidence on the current frame; shown in pose mode",
        update=_recolour,
    )
    below: bpy.props.FloatProperty(
        name="Doubtful Below", description="Confidence below which a frame deserves a look",
        default=0.5, min=0.02, max=0.98,
    )  # fmt: skip
    first: bpy.props.IntProperty(name="First", description="First scene frame to solve again", default=1)
    last: bpy.props.IntProperty(name="Last", description="Last scene frame to solve again", default=1)
    pins: bpy.props.CollectionProperty(type=MocapPin)

    @property
    def take(self) -> bpy.types.Action | None:
        """The solved action that the body plays now."""
        animation = self.armature.animation_data if self.armature is not None else None
        action = animation.action if animation is not None else None
        return action if action is not None and "motion_file" in action else None


class MocapSettings(bpy.types.PropertyGroup):
    """Everything of one scene."""

    folder: bpy.props.StringProperty(
        name="Folder", subtype="DIR_PATH", options=RELATIVE,
        description="Where captures and takes are written; empty for 'mocap' beside the .blend file",
    )  # fmt: skip
    reading: bpy.props.PointerProperty(type=MocapReading)
    capture: bpy.props.PointerProperty(type=MocapCapture)
    solve: bpy.props.PointerProperty(type=MocapSolve)
    review: bpy.props.PointerProperty(type=MocapReview)


CLASSES = (
    MocapMessage, MocapCamera, MocapReading, MocapCapture, MocapSolve, MocapPin, MocapReview, MocapSettings,
)  # fmt: skip
"""In the order of registration: what is pointed to comes first."""
