"""The job file: everything one solve needs, as JSON; the same file works on the command line and in Blender."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from .errors import JobInvalid, OutputNotWritable
from .outputs import write_text
from .reading_settings import ROWS, ReadingSettings, TimeSettings, WorldSettings
from .setting import values_that_differ

VERSION = 1  # Of the schema; a job of another version is refused.
MOTION_SUFFIX = ".npz"
_PATHS = ("report", "subject", "start", "labels")


@dataclass(frozen=True)
class JobPin:
    """A pose the animator set, which the solver must keep."""

    frame: int
    """Frame of the capture, from 0."""
    global_orient: Sequence[float]
    """(3,) axis-angle, body to world."""
    body_pose: Sequence[float]
    """(69,) axis-angle of joints 1..23."""
    transl: Sequence[float]
    """(3,) metres."""

    def as_dict(self) -> dict[str, object]:
        """Return plain values."""
        return {
            "frame": int(self.frame),
            "global_orient": [float(v) for v in self.global_orient],
            "body_pose": [float(v) for v in self.body_pose],
            "transl": [float(v) for v in self.transl],
        }


@dataclass(frozen=True)
class JobRange:
    """A range of frames of an earlier motion to solve again."""

    motion: Path
    """Motion file that stays as it is outside the range."""
    first: int
    """First frame, from 0."""
    last: int
    """Last frame, included."""
    pins: tuple[JobPin, ...] = ()
    """Poses inside the range that are kept."""

    def as_dict(self) -> dict[str, object]:
        """Return plain values."""
        pins = [pin.as_dict() for pin in self.pins]
        return {"motion": str(self.motion), "first": int(self.first), "last": int(self.last), "pins": pins}


@dataclass(frozen=True)
class JobFile(ReadingSettings, TimeSettings, WorldSettings):
    """One solve: what is read, how it is solved, where the result goes.

    Raises:
        JobInvalid: the motion's name has another ending, two of the files are one, or a path or setting is invalid.
    """

    capture: Path
    """File or folder of the capture."""
    out: Path
    """Motion file to be written."""
    report: Path | None = None
    """HTML page to be written; None for none."""
    overwrite: bool = False
    """Replace results that are already there."""
    strict: bool = False
    """Refuse a result that has warnings, and write nothing."""
    subject: Path | None = None
    """Subject file of the person whose markers are solved, None to calibrate on the take itself."""
    start: Path | None = None
    """Earlier motion of these frames at which several cameras start, such as that of one of them."""
    labels: Path | None = None
    """File of user-assigned labels of points of a recording of markers; the solver never overrides them."""
    settings: Any = field(default_factory=dict)
    """Settings of the solve by name; the solver has defaults for those left out."""
    resolve: Any = None
    """``JobRange``: solve only some frames of an earlier motion again; None for the whole take."""

    def __post_init__(self) -> None:
        TimeSettings.__post_init__(self)  # which checks the settings of every class
        earlier = None if self.resolve is None else self.resolve.motion
        files = (self.capture, self.out, *(getattr(self, name) for name in _PATHS), earlier)
        if any("\0" in str(path) for path in files if path is not None):
            raise JobInvalid("A path of the job holds the character U+0000, which no path can have.", where="job")
        if self.out.suffix.lower() != MOTION_SUFFIX:
            hint = f"Try {self.out.name}{MOTION_SUFFIX}."
            raise JobInvalid(f"A motion file ends in {MOTION_SUFFIX}.", where=f"out = {self.out}", hint=hint)
        # A motion that came without its recording is measured by itself: then it stands in for the capture.
        again = earlier is not None and earlier.resolve() == self.capture.resolve()
        places = [p.resolve() for p in (files[:-1] if again else files) if p is not None]
        if len(set(places)) < len(places):
            what = "Capture, motion, report, subject, names and earlier motion must be different files."
            raise JobInvalid(what, where=str(self.out))

    def as_dict(self) -> dict[str, object]:
        """Return plain values in the file's schema; what is left at its default is left out."""
        given = {name: getattr(self, name) for name in ("overwrite", "strict", "settings")}
        given |= {name: str(value) for name in _PATHS if (value := getattr(self, name))}
        given["resolve"] = self.resolve and self.resolve.as_dict()
        values = {"version": VERSION, "capture": str(self.capture), "out": str(self.out)}
        return values | {name: value for name, value in given.items() if value} | values_that_differ(self, ROWS)


def write_job(path: Path, job: JobFile) -> None:
    """Write a job file, complete or not at all.

    Raises:
        OutputNotWritable: the folder cannot be made or written to.
    """
    try:
        write_text(path, json.dumps(job.as_dict(), indent=2, ensure_ascii=False), overwrite=True)
    except OutputNotWritable as error:
        message, hint = error.message.replace("The output", "The job", 1), "Choose a writable folder with free space."
        raise OutputNotWritable(message, where=str(path.parent), hint=hint) from error
