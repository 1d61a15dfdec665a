"""Declare the options for reading recordings, which the command line, jobs and panels use."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from .errors import JobInvalid
from .joint_sets import JointSet
from .setting import Choice, Setting, check_settings, setting, settings_of_class

READING, TIME, WORLD = "Reading", "Time", "World"  # Groups.
AUTO, ON, OFF = "auto", "on", "off"
LEVELS = (
    Choice(AUTO, "If Certain", "Correct a tilt indicated by balance, feet and cameras (recommended)"),
    Choice(ON, "From the Person", "Level the world from a walking person, for a tilted calibration"),
    Choice(OFF, "As Calibrated", "Keep the up direction and floor of the calibration"),
)
_JOINT_SETS = ", ".join(joint_set.value for joint_set in JointSet)
_reading, _time, _world = (partial(setting, group=group) for group in (READING, TIME, WORLD))


@dataclass(frozen=True, kw_only=True)
class TimeSettings:
    """Settings that map camera names and select frames.

    Raises:
        JobInvalid: ``camera`` is not of the form RECORDED=CALIBRATED, ``offset`` is not of the form CAMERA=FRAMES, or
            ``frames`` is not a range.
    """

    # fmt: off
    camera: tuple[str, ...] = _time(
        "texts", (), "Camera Names", "Name of a recorded camera, and its name in the calibration",
        metavar="RECORDED=CALIBRATED", rare=True)
    offset: tuple[str, ...] = _time(
        "texts", (), "Start Offsets", "Frames by which a camera started after the others (negative: before), instead "
        "of an estimate", metavar="CAMERA=FRAMES", rare=True)
    by_order: bool = _time(
        "switch", False, "Frames by Order", "Ignore the frame numbers in the files, if all cameras started "
        "together", rare=True)
    frames: tuple[int, int] | None = _time(
        "range", None, "Frames", "First and last frame of the take to read, counted from 0", metavar="FIRST LAST")
    # fmt: on

    def __post_init__(self) -> None:
        check_settings(self)
        calibrated_names(self.camera)
        offsets_by_camera(self.offset)


@dataclass(frozen=True, kw_only=True)
class WorldSettings:
    """Settings that scale, level or move the calibrated cameras before the solve."""

    # fmt: off
    stature: float = _world(
        "number", 0.0, "Stature", "Height of the person without shoes, which sets the scale (0 keeps the "
        "calibration's)", low=0, high=2.6, unit="m")
    scale: float = _world(
        "number", 1.0, "Scale", "Factor for all lengths of the calibration, if its unit is unknown", low=1e-6, high=1e6,
        soft_high=10, rare=True)
    """Length factor, for example the side of a board square in metres if the calibration's unit is a square."""
    level: str = _world(
        "choice", AUTO, "Level", "Rotation and shift that make Z point up and put the floor at z = 0",
        choices=LEVELS, metavar="NAME", rare=True)
    camera_path: str = _world(
        "file", "", "Camera Path", "File with the path of a moving camera: COLMAP text model, TUM trajectory, or "
        "JSON from ARKit, ARCore or Blender", metavar="FILE", rare=True)
    # fmt: on

    def __post_init__(self) -> None:
        check_settings(self)

    @property
    def changes_world(self) -> bool:
        """True if these settings change every capture's world. Automatic levelling changes only some."""
        return bool(self.stature) or self.scale != 1.0 or self.level == ON or bool(self.camera_path)


@dataclass(frozen=True, kw_only=True)
class ReadingSettings:
    """Facts that the recorded files may not contain, such as the frame rate and the length unit."""

    # fmt: off
    fps: float | None = _reading(
        "number", None, "Frame Rate", "Frame rate, if the capture states none or a wrong one", low=1e-3, high=1e6,
        soft_high=240, unit="Hz")
    joint_set: str | None = _reading(
        "text", None, "Keypoints", f"Joint set, if several match the number of keypoints: {_JOINT_SETS}",
        metavar="NAME", control="*Keypoints*", rare=True)
    unit: str | None = _reading(
        "text", None, "Unit", "Length unit of the recording: m, cm, mm, inch or foot", metavar="UNIT",
        control="*Unit*")
    up_axis: str | None = _reading(
        "text", None, "Up Axis", "Axis that points up: x, y, z, -x, -y or -z", metavar="AXIS",
        control="*Up Axis*")
    trim: bool = _reading(
        "switch", False, "Cut to the Shortest", "Drop frames that are missing from some cameras", rare=True)
    as_calibrated: bool = _reading(
        "switch", False, "Calibration as Written",
        "Trust the calibration file, even if the views contradict it", rare=True)
    subject_prefix: str | None = _reading(
        "text", None, "Subject", "Label prefix of the person to solve, or several prefixes for the parts of one "
        "person", metavar="NAME[,NAME…]", rare=True)
    person: str | None = _reading(
        "text", None, "Person", "Name of the person to solve, as listed by info", metavar="NAME",
        control="the list of people")
    # fmt: on

    def __post_init__(self) -> None:
        check_settings(self)


ROWS: dict[str, Setting] = {
    name: row for one in (ReadingSettings, TimeSettings, WorldSettings) for name, row in settings_of_class(one).items()
}
"""Every reading option."""
DEFAULTS: dict[str, Any] = {name: row.default for name, row in ROWS.items()}  # Their default values.


def offsets_by_camera(texts: Sequence[str]) -> dict[str, int]:
    """Return each camera's delay in frames from texts such as ``cam02=60``."""
    found: dict[str, int] = {}
    for text in texts:
        name, _, frames = (part.strip() for part in text.rpartition("="))
        try:
            found[name] = int(frames)
        except ValueError:
            name = ""
        if not name:
            message = f"The offset '{text}' is not CAMERA=FRAMES with whole frames."
            hint = "Write whole frames, such as cam02=60 for a camera that started 60 frames late."
            raise JobInvalid(message, where="offset", hint=hint)
    return found


def calibrated_names(texts: Sequence[str]) -> dict[str, str]:
    """Return the calibrated name of each recorded camera from texts such as ``hall_left=cam02``."""
    found: dict[str, str] = {}
    for text in texts:
        recorded, _, calibrated = (part.strip() for part in text.partition("="))
        if not recorded or not calibrated:
            raise JobInvalid(f"The camera '{text}' is not RECORDED=CALIBRATED.", where="camera")
        found[recorded] = calibrated
    return found


def options_of(values: Mapping[str, Any]) -> list[str]:
    """Convert reading settings to command line options of the solver. Defaults are omitted."""
    given = {name: value for name, row in ROWS.items() if (value := values.get(name)) != row.default}
    return [word for name, value in given.items() for word in ROWS[name].words(value)]
