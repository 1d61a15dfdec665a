"""How a recording is read where its files leave it open, declared once for the command line, jobs and panels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from .errors import JobInvalid
from .setting import Choice, Setting, check_settings, defaults_of_class, is_list, setting, settings_of_class

TIME = "Time"
"""The group."""


@dataclass(frozen=True, kw_only=True)
class TimeSettings:
    """Which cameras and frames belong together, where the user knows it.

    Raises:
        JobInvalid: a value is of another type, a camera is not RECORDED=CALIBRATED, an offset is not CAMERA=FRAMES, or
            frames are no range.
    """

    camera: tuple[str, ...] = setting(
        "texts", (), "Camera Names", "Which camera of the calibration a recorded one is, if the names do not match",
        group=TIME, metavar="RECORDED=CALIBRATED",
    )  # fmt: skip
    offset: tuple[str, ...] = setting(
        "texts", (), "Start Offsets", "Frames by which a camera started later than the take, negative for earlier; "
        "nothing is then estimated", group=TIME, metavar="CAMERA=FRAMES",
    )  # fmt: skip
    by_order: bool = setting(
        "switch", False, "Frames by Order", "Count each camera's frames from its first, whatever their numbers are",
        group=TIME,
    )  # fmt: skip
    frames: tuple[int, int] | None = setting(
        "range", None, "Frames", "First and last frame of the take that are read, from 0", group=TIME,
        metavar="FIRST LAST",
    )  # fmt: skip
    """None for all."""

    def __post_init__(self) -> None:
        check_settings(self)
        calibrated_names(self.camera)
        offsets_by_camera(self.offset)


def offsets_by_camera(texts: Sequence[str]) -> dict[str, int]:
    """Return the frames by which cameras started late, by name, of texts such as ``cam02=60``.

    Raises:
        JobInvalid: a text names no camera, or no whole number.
    """
    found: dict[str, int] = {}
    for text in texts:
        name, _, frames = text.rpartition("=")
        try:
            found[name.strip()] = int(frames)
        except ValueError:
            name = ""
        if not name.strip():
            raise JobInvalid(
                f"The offset '{text}' is not CAMERA=FRAMES with whole frames.", where="offset",
                hint="Such as cam02=60 for a camera that started 60 frames late; the solve finds what is left.",
            )  # fmt: skip
    return found


def calibrated_names(texts: Sequence[str]) -> dict[str, str]:
    """Return the calibrated names of recorded cameras, of texts such as ``hall_left=cam02``.

    Raises:
        JobInvalid: a text lacks one of the names.
    """
    found: dict[str, str] = {}
    for text in texts:
        recorded, _, calibrated = (part.strip() for part in text.partition("="))
        if not recorded or not calibrated:
            raise JobInvalid(f"The camera '{text}' is not RECORDED=CALIBRATED.", where="camera")
        found[recorded] = calibrated
    return found


def time_values(values: Any) -> dict[str, Any]:
    """Return the settings of time that an object has and that are not at their defaults, as plain values by name."""
    given = {
        "camera": list(values.camera),
        "offset": list(values.offset),
        "by_order": values.by_order,
        "frames": values.frames,
    }
    return {name: list(v) if isinstance(v, tuple) else v for name, v in given.items() if v}


WORLD = "World"
"""The group."""
AUTO, ON, OFF = "auto", "on", "off"
LEVELS = (
    Choice(AUTO, "Where Sure", "Level the world where balance, floor and cameras show that it is tilted"),
    Choice(ON, "By the Person", "Level the world by the person who stands and walks in it"),
    Choice(OFF, "As Calibrated", "Keep up and floor of the calibration"),
)


@dataclass(frozen=True, kw_only=True)
class WorldSettings:
    """What is done to the calibration's world before anything is solved.

    Raises:
        JobInvalid: a value is of another type or out of range.
    """

    stature: float = setting(
        "number", 0.0, "Stature", "Height of the person, to which the world is scaled; 0 keeps the calibration's scale",
        group=WORLD, low=0, high=2.6, unit="m",
    )  # fmt: skip
    """The person is whoever is solved; in metres, barefoot."""
    scale: float = setting(
        "number", 1.0, "Scale", "Factor on the lengths of the calibration, if its unit is not a known one",
        group=WORLD, low=1e-6, high=1e6, soft_high=10,
    )  # fmt: skip
    """Such as the size of a board's square in metres, where the board was calibrated in squares."""
    level: str = setting(
        "choice", AUTO, "Level", "Whether the world is levelled: Z up, the floor at z = 0",
        group=WORLD, choices=LEVELS, metavar="NAME",
    )  # fmt: skip

    def __post_init__(self) -> None:
        check_settings(self)

    @property
    def changes_world(self) -> bool:
        """Whether the world is to be changed whatever is found."""
        return bool(self.stature) or self.scale != 1.0 or self.level == ON


def world_values(values: Any) -> dict[str, Any]:
    """Return the settings of the world that an object has and that are not at their defaults, by name."""
    defaults = defaults_of_class(WorldSettings)
    return {name: getattr(values, name) for name in defaults if getattr(values, name) != defaults[name]}


READING = "Reading"
"""The group."""


@dataclass(frozen=True, kw_only=True)
class ReadingSettings:
    """What the files of a recording leave open.

    Raises:
        JobInvalid: a value is of another type or out of range.
    """

    fps: float | None = setting(
        "number", None, "Frame Rate", "Frames per second, if the capture has none", group=READING,
        low=1e-3, high=1e6, soft_high=240, unit="Hz",
    )  # fmt: skip
    joint_set: str | None = setting(
        "text", None, "Keypoints", "Keypoint set, when the number of keypoints fits several", group=READING,
        metavar="NAME", in_panel=False,
    )  # fmt: skip
    """The panel lists the sets."""
    unit: str | None = setting(
        "text", None, "Unit", "Length unit of the recording, such as m or mm, to override the file's", group=READING,
        metavar="UNIT", in_panel=False,
    )  # fmt: skip
    """The panel lists the units."""
    up_axis: str | None = setting(
        "text", None, "Up Axis", "Axis that points up in the recording, if not z", group=READING, metavar="AXIS",
        in_panel=False,
    )  # fmt: skip
    """The panel lists the axes."""
    trim: bool = setting(
        "switch", False, "Cut to the Shortest", "Cut cameras of different lengths to the frames all have", group=READING
    )
    as_calibrated: bool = setting(
        "switch", False, "Calibration as Written",
        "Read the calibration as it is written, even where the views agree far better when it is read otherwise",
        group=READING,
    )  # fmt: skip
    subject_prefix: str | None = setting(
        "text", None, "Subject", "Label prefix of the person, when a file holds several; several prefixes are parts of "
        "one person", group=READING, metavar="NAME[,NAME…]",
    )  # fmt: skip
    person: str | None = setting(
        "text", None, "Person", "Which person to solve, when there are several (see people)", group=READING,
        metavar="NAME", in_panel=False,
    )  # fmt: skip
    """The panel lists the people of a capture once it is read."""

    def __post_init__(self) -> None:
        check_settings(self)


ROWS: dict[str, Setting] = {
    name: row for one in (ReadingSettings, TimeSettings, WorldSettings) for name, row in settings_of_class(one).items()
}
"""Every setting of how a capture is read."""
DEFAULTS: dict[str, Any] = {
    name: value
    for one in (ReadingSettings, TimeSettings, WorldSettings)
    for name, value in defaults_of_class(one).items()
}
"""What they are where they are not given."""


def reading_values(values: Any) -> dict[str, Any]:
    """Return the settings of how a recording is read that an object has, as plain values; without those left out."""
    return {name: str(value) if isinstance(value, str) else value
            for name in settings_of_class(ReadingSettings) if (value := getattr(values, name))}  # fmt: skip


def options_of(values: Mapping[str, Any]) -> list[str]:
    """Return the options of the solver's command line for plain values of how a capture is read.

    Args:
        values: by name; what is missing, None or at its default needs no option.
    """
    return [word for name, row in ROWS.items() for word in _words(name, row, values.get(name))]


def _words(name: str, row: Setting, value: Any) -> list[str]:
    option = f"--{name.replace('_', '-')}"
    if value is None or value == DEFAULTS[name] or (is_list(value) and not value):
        return []
    if row.kind == "texts":
        return [f"{option}={text}" for text in value]
    if row.kind == "range":
        return [option, *map(str, value)]
    return (
        [option]
        if row.kind == "switch"
        else [f"{option}={value:g}" if isinstance(value, float) else f"{option}={value}"]
    )
