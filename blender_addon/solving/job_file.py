"""The job file: everything a solve needs, as JSON; the same file works on the command line."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..errors import OutputNotWritable

VERSION = 1


@dataclass(frozen=True)
class Pin:
    """A pose the animator set, which the solver must keep."""

    frame: int
    """Frame of the capture, from 0."""
    global_orient: Sequence[float]
    """(3,) axis-angle, body to world."""
    body_pose: Sequence[float]
    """(69,) axis-angle of joints 1..23."""
    transl: Sequence[float]
    """(3,) metres."""

    def as_dict(self) -> dict[str, Any]:
        """Return plain values."""
        return {
            "frame": int(self.frame),
            "global_orient": [float(v) for v in self.global_orient],
            "body_pose": [float(v) for v in self.body_pose],
            "transl": [float(v) for v in self.transl],
        }


@dataclass(frozen=True)
class Resolve:
    """A stretch of an earlier motion to solve again."""

    motion: Path
    """Motion file that stays as it is outside the stretch."""
    first: int
    """First frame, from 0."""
    last: int
    """Last frame, included."""
    pins: tuple[Pin, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """Return plain values."""
        pins = [pin.as_dict() for pin in self.pins]
        return {"motion": str(self.motion), "first": int(self.first), "last": int(self.last), "pins": pins}


@dataclass(frozen=True)
class Job:
    """One solve."""

    capture: Path
    """Capture file."""
    out: Path
    """Motion file to be written."""
    report: Path | None = None
    """Page to be written."""
    settings: dict[str, Any] = field(default_factory=dict)
    """Settings of the solve that are not the solver's own defaults."""
    resolve: Resolve | None = None

    def as_dict(self) -> dict[str, Any]:
        """Return plain values, in the solver's schema."""
        values: dict[str, Any] = {"version": VERSION, "capture": str(self.capture), "out": str(self.out)}
        if self.report is not None:
            values["report"] = str(self.report)
        if self.settings:
            values["settings"] = self.settings
        if self.resolve is not None:
            values["resolve"] = self.resolve.as_dict()
        return values


def write_job(path: Path, job: Job) -> None:
    """Write a job file, complete or not at all.

    Raises:
        OutputNotWritable: the folder cannot be made or written to.
    """
    temporary = path.with_name(f".part{os.getpid()}_{path.name}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary.write_text(json.dumps(job.as_dict(), indent=2, ensure_ascii=False), encoding="utf-8")
        os.replace(temporary, path)
    except OSError as error:
        with suppress(OSError):
            temporary.unlink()
        raise OutputNotWritable(
            f"The job cannot be written: {error.strerror or error}.",
            where=str(path.parent),
            hint="Choose a folder for takes that you may write to, with free space.",
        ) from error
