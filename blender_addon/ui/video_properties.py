"""What the add-on keeps about a capture's way from its videos."""

from __future__ import annotations

from typing import Any

import bpy

from .._exchange.detectors import DETECTORS
from .._exchange.video_settings import DEFAULTS, ROWS
from .locations import RELATIVE
from .setting_properties import make_property

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
    return make_property(ROWS[name], DEFAULTS[name])


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


VIDEO_CLASSES = (MocapVideoPicture, MocapVideoStep, MocapVideos)
"""In the order of registration."""
