"""Define the job file, which describes one solve completely as JSON."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import MISSING, dataclass, field, fields
from pathlib import Path
from typing import Any

from .errors import JobInvalid, OutputNotWritable
from .json_file import as_plain
from .outputs import write_text
from .reading_settings import ROWS, ReadingSettings, TimeSettings, WorldSettings

VERSION = 1  # Schema version. Jobs with another version are rejected.
MOTION_SUFFIX = ".npz"


@dataclass(frozen=True)
class JobPin:
    """A pose that the animator set and the solver preserves."""

    frame: int  # Frame in the capture, from 0.
    global_orient: Sequence[float]  # Axis-angle vector of the pelvis, from body to world, 3 numbers.
    body_pose: Sequence[float]  # Axis-angle vectors of joints 1 to 23 as 69 numbers, or 153 numbers with fingers.
    transl: Sequence[float]  # Translation in metres, 3 numbers.


@dataclass(frozen=True)
class JobContact:
    """A contact between a body part and the floor that the animator added or removed."""

    part: str  # Body part: left_foot, right_foot, left_knee, ..., seat, back or head.
    first: int  # First frame, from 0.
    last: int  # Last frame (inclusive).
    touches: bool  # True adds the contact. False removes it.


@dataclass(frozen=True)
class JobRange:
    """A frame range in an earlier motion that is to be solved again."""

    motion: Path  # Earlier motion, which remains unchanged outside the range.
    first: int  # First frame, from 0.
    last: int  # Last frame (inclusive).
    pins: tuple[JobPin, ...] = ()  # Fixed poses within the range.
    contacts: tuple[JobContact, ...] = ()  # Floor contacts within the range. Later items override earlier ones.
    forgets: bool = False  # Ignore contacts from earlier solves of the range.


@dataclass(frozen=True)
class JobFile(ReadingSettings, TimeSettings, WorldSettings):
    """One solve: input, settings and output.

    Raises:
        JobInvalid: ``out`` has the wrong suffix, two files have the same path, or a path or setting is invalid.
    """

    capture: Path  # File or folder with the capture.
    out: Path  # Motion file to write.
    report: Path | None = None  # HTML report to write, or None for no report.
    overwrite: bool = False  # Replace existing results.
    strict: bool = False  # Refuse a result that has warnings, and write nothing.
    subject: Path | None = None  # Subject file for the person. If None, the person is calibrated from the take.
    start_from: tuple[str, ...] = ()  # Earlier motions or network results to start from, each as ``[CAMERA=]FILE``.
    labels: Path | None = None  # File with labels that the user assigned to markers. The solver never overrides them.
    settings: Any = field(default_factory=dict)  # Solve settings that differ from their defaults, by key.
    resolve: Any = None  # Frames of an earlier motion to solve again. If None, the whole take is solved.

    def __post_init__(self) -> None:
        TimeSettings.__post_init__(self)  # checks the settings of all classes
        earlier = None if self.resolve is None else self.resolve.motion
        files = [value for item in fields(self) if isinstance(value := getattr(self, item.name), Path)]
        files += [start_of(text)[1] for text in self.start_from]
        if any("\0" in str(path) for path in (*files, earlier)):
            raise JobInvalid("A path in the job contains the character U+0000, which no path can contain.", where="job")
        if self.out.suffix.lower() != MOTION_SUFFIX:
            hint = f"Try {self.out.name}{MOTION_SUFFIX}."
            raise JobInvalid(f"A motion file must end in {MOTION_SUFFIX}.", where=f"out = {self.out}", hint=hint)
        if self.resolve is not None and self.start_from:
            what = "`resolve` and `start_from` cannot be combined, because a range starts from its own motion."
            raise JobInvalid(what, where="start_from", hint="Omit `start_from`, or solve the whole take.")
        # A motion whose recording is not available is its own capture. It may also be the earlier motion.
        if earlier is not None and earlier.resolve() != self.capture.resolve():
            files.append(earlier)
        if len({path.resolve() for path in files}) < len(files):
            what = "Capture, motion, report, subject, labels and earlier motion must be different files."
            raise JobInvalid(what, where=str(self.out), hint="Choose another name for the result.")

    def as_dict(self) -> dict[str, object]:
        """Return the version and all non-default fields as plain JSON values."""
        values: dict[str, Any] = {"version": VERSION}
        for item in sorted(fields(self), key=lambda item: item.name in ROWS):
            value, default = getattr(self, item.name), None if item.default is MISSING else item.default
            if value != default and (value or default):
                values[item.name] = as_plain(value)
        for name in ("contacts", "forgets"):
            if self.resolve is not None and not getattr(self.resolve, name):
                del values["resolve"][name]  # keeps job files that do not use these fields unchanged
        return values


def start_of(text: str, folder: Path = Path()) -> tuple[str, Path]:
    """Split ``[CAMERA=]FILE`` into the camera ("" for none) and the file, relative to ``folder``.

    If the whole text is the name of an existing file, it is not split, even if it contains an equals sign.
    """
    if "=" not in text or os.path.exists(folder / text):
        return "", folder / text
    camera, _, file = text.partition("=")
    return camera, folder / file


def write_job(path: Path, job: JobFile) -> None:
    """Write a job file, either completely or not at all."""
    try:
        write_text(path, json.dumps(job.as_dict(), indent=2, ensure_ascii=False), overwrite=True)
    except OutputNotWritable as error:
        message, hint = error.message.replace("The output", "The job", 1), "Choose a writable folder with free space."
        raise OutputNotWritable(message, where=str(path.parent), hint=hint) from error
