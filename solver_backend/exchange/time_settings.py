"""Which cameras and frames belong together, declared once for the command line, jobs and panels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from .errors import JobInvalid
from .setting import check_settings, setting

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
