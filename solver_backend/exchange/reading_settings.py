"""Reading options of recordings, declared once for the command line, jobs and panels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from .errors import JobInvalid
from .setting import Choice, Setting, check_settings, setting, settings_of_class

READING, TIME, WORLD = "Reading", "Time", "World"  # Groups.
AUTO, ON, OFF = "auto", "on", "off"
LEVELS = (
    Choice(AUTO, "Where Sure", "Level the world where balance, floor and cameras show that it is tilted"),
    Choice(ON, "By the Person", "Level the world by the person who stands and walks in it"),
    Choice(OFF, "As Calibrated", "Keep up and floor of the calibration"),
)


@dataclass(frozen=True, kw_only=True)
class TimeSettings:
    """Settings that assign cameras and frames.

    Raises:
        JobInvalid: a camera is not RECORDED=CALIBRATED, an offset is not CAMERA=FRAMES, or frames are not a range.
    """

    # fmt: off
    camera: tuple[str, ...] = setting(
        "texts", (), "Camera Names", "Which camera of the calibration a recorded one is, if the names do not match",
        group=TIME, metavar="RECORDED=CALIBRATED")
    offset: tuple[str, ...] = setting(
        "texts", (), "Start Offsets", "Frames by which a camera started later than the take, negative for earlier; "
        "nothing is then estimated", group=TIME, metavar="CAMERA=FRAMES")
    by_order: bool = setting(
        "switch", False, "Frames by Order", "Count each camera's frames from its first, whatever their numbers are",
        group=TIME)
    frames: tuple[int, int] | None = setting(
        "range", None, "Frames", "First and last frame of the take that are read, from 0", group=TIME,
        metavar="FIRST LAST")
    # fmt: on

    def __post_init__(self) -> None:
        check_settings(self)
        calibrated_names(self.camera)
        offsets_by_camera(self.offset)


@dataclass(frozen=True, kw_only=True)
class WorldSettings:
    """Changes to the calibration's world before anything is solved."""

    # fmt: off
    stature: float = setting(
        "number", 0.0, "Stature", "Height of the person, to which the world is scaled; 0 keeps the calibration's scale",
        group=WORLD, low=0, high=2.6, unit="m")
    """Of the person who is solved, barefoot."""
    scale: float = setting(
        "number", 1.0, "Scale", "Factor on the lengths of the calibration, if its unit is not a known one",
        group=WORLD, low=1e-6, high=1e6, soft_high=10)
    """For example the size of a board's square in metres, where the board was calibrated in squares."""
    level: str = setting(
        "choice", AUTO, "Level", "Whether the world is levelled: Z up, the floor at z = 0",
        group=WORLD, choices=LEVELS, metavar="NAME")
    # fmt: on

    def __post_init__(self) -> None:
        check_settings(self)

    @property
    def changes_world(self) -> bool:
        """Whether the world changes in any case."""
        return bool(self.stature) or self.scale != 1.0 or self.level == ON


@dataclass(frozen=True, kw_only=True)
class ReadingSettings:
    """Facts that the files of a recording may lack. The panel has its own lists of sets, units, axes and people."""

    # fmt: off
    fps: float | None = setting(
        "number", None, "Frame Rate", "Frames per second, if the capture has none", group=READING,
        low=1e-3, high=1e6, soft_high=240, unit="Hz")
    joint_set: str | None = setting(
        "text", None, "Keypoints", "Keypoint set, when the number of keypoints fits several", group=READING,
        metavar="NAME", in_panel=False)
    unit: str | None = setting(
        "text", None, "Unit", "Length unit of the recording, such as m or mm, to override the file's", group=READING,
        metavar="UNIT", in_panel=False)
    up_axis: str | None = setting(
        "text", None, "Up Axis", "Axis that points up in the recording, if not z", group=READING, metavar="AXIS",
        in_panel=False)
    trim: bool = setting(
        "switch", False, "Cut to the Shortest", "Cut cameras of different lengths to the frames all have",
        group=READING)
    as_calibrated: bool = setting(
        "switch", False, "Calibration as Written",
        "Read the calibration as it is written, even where the views agree far better when it is read otherwise",
        group=READING)
    subject_prefix: str | None = setting(
        "text", None, "Subject", "Label prefix of the person, when a file holds several; several prefixes are parts of "
        "one person", group=READING, metavar="NAME[,NAME…]")
    person: str | None = setting(
        "text", None, "Person", "Which person to solve, when there are several (see people)", group=READING,
        metavar="NAME", in_panel=False)
    # fmt: on

    def __post_init__(self) -> None:
        check_settings(self)


ROWS: dict[str, Setting] = {
    name: row for one in (ReadingSettings, TimeSettings, WorldSettings) for name, row in settings_of_class(one).items()
}
"""Every setting of how a capture is read."""
DEFAULTS: dict[str, Any] = {name: row.default for name, row in ROWS.items()}  # Their defaults.


def offsets_by_camera(texts: Sequence[str]) -> dict[str, int]:
    """Return the late frames of each camera, from texts such as ``cam02=60``."""
    found: dict[str, int] = {}
    for text in texts:
        name, _, frames = (part.strip() for part in text.rpartition("="))
        try:
            found[name] = int(frames)
        except ValueError:
            name = ""
        if not name:
            message = f"The offset '{text}' is not CAMERA=FRAMES with whole frames."
            hint = "Such as cam02=60 for a camera that started 60 frames late; the solve finds what is left."
            raise JobInvalid(message, where="offset", hint=hint)
    return found


def calibrated_names(texts: Sequence[str]) -> dict[str, str]:
    """Return the calibrated names of recorded cameras, from texts such as ``hall_left=cam02``."""
    found: dict[str, str] = {}
    for text in texts:
        recorded, _, calibrated = (part.strip() for part in text.partition("="))
        if not recorded or not calibrated:
            raise JobInvalid(f"The camera '{text}' is not RECORDED=CALIBRATED.", where="camera")
        found[recorded] = calibrated
    return found


def options_of(values: Mapping[str, Any]) -> list[str]:
    """Return the solver's command-line options for plain values by name, without missing ones and defaults."""
    given = {name: value for name, row in ROWS.items() if (value := values.get(name)) != row.default}
    return [word for name, value in given.items() for word in ROWS[name].words(value)]
