"""How a recording is read where its files leave it open, declared once for the command line, jobs and panels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from .setting import Setting, check_settings, defaults_of_class, is_list, setting, settings_of_class
from .time_settings import TimeSettings
from .world_settings import WorldSettings

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
