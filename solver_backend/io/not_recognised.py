"""What a path is that is no capture, and what helps."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

from solver_backend.exchange.errors import CaptureNotRecognised
from solver_backend.io.captures.pose2sim import trials_below
from solver_backend.io.detections.search import DETECTION_FOLDERS, camera_sources
from solver_backend.io.detections.unsupported import name_unsupported
from solver_backend.io.footage import SENSOR_RECORDING, count_recordings
from solver_backend.io.markers.unsupported import name_unsupported_file
from solver_backend.io.reader import Reader
from solver_backend.io.recognition.camera_names import listing
from solver_backend.types import Capture

_NAMED = 5
"""Folders, or kinds of files, that an error names."""


def no_capture(path: Path, readers: Iterable[Reader[Capture]]) -> CaptureNotRecognised:
    """Return the error about a path that none of the readers recognises."""
    hint = f"Captures are {'; '.join(dict.fromkeys(reader.kind for reader in readers))}."
    if not path.is_dir():
        if path.is_file() and (known := name_unsupported_file(path)) is not None:
            what, how = known
            return CaptureNotRecognised(f"The file is {what}", where=str(path), hint=how)
        what = "is not a readable capture" if path.exists() else "does not exist"
        return CaptureNotRecognised(f"The path {what}.", where=str(path), hint=hint)
    if (path / SENSOR_RECORDING).is_file():
        return CaptureNotRecognised(
            "The folder is a recording of infrared and depth sensors; their markers are not found yet.",
            where=str(path), hint=f"markers-from-sensors {path.name} --out {path.name}.npz finds them.",
        )  # fmt: skip
    if trials := trials_below(path):
        what, hint = "The folder is not a recording but holds several.", f"Choose one: {listing(trials)}."
        return CaptureNotRecognised(what, where=str(path), hint=hint)
    folders = [path, *(path / name for name in DETECTION_FOLDERS)]
    if (known := name_unsupported(folders)) is not None:
        what, how = known
        return CaptureNotRecognised(f"The detections are {what}", where=str(path), hint=how)
    if (footage := count_recordings(path)) > 1:
        return CaptureNotRecognised(
            f"The folder holds videos or pictures of {footage} cameras, and no detections in them.", where=str(path),
            hint="from-videos detects, synchronises, calibrates and solves them (Capture from Videos in Blender).",
        )  # fmt: skip
    if deeper := [below.name for below in sorted(path.iterdir()) if below.is_dir() and camera_sources(below)]:
        what = f"The folder holds no detections of its own; {listing(deeper[:_NAMED])} in it does."
        return CaptureNotRecognised(what, where=str(path), hint=f"Choose {path / deeper[0]}.")
    if (known := name_unsupported(folders, packed=True)) is not None:
        what, how = known
        return CaptureNotRecognised(f"The detections are {what}", where=str(path), hint=how)
    what = f"The folder holds no detections that are read: {_contents(path)}."
    return CaptureNotRecognised(what, where=str(path), hint=hint)


def _contents(folder: Path) -> str:
    """Return what a folder holds, by the endings of its files' names."""
    with os.scandir(folder) as entries:
        kinds = Counter("folders" if e.is_dir() else Path(e.name).suffix.lower() or "files" for e in entries)
    return listing(f"{count} {kind}" for kind, count in kinds.most_common(_NAMED)) if kinds else "it is empty"
