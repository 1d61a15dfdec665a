"""Read a capture, or a motion, whatever kind of file or folder it is (see ``registry``)."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

from solver_backend.exchange.diagnostics import diagnostic
from solver_backend.exchange.errors import CaptureNotRecognised, JobInvalid, MotionInvalid
from solver_backend.io.captures.pose2sim import trials_below
from solver_backend.io.detections.search import DETECTION_FOLDERS, camera_sources
from solver_backend.io.detections.unsupported import name_unsupported
from solver_backend.io.footage.footage import SENSOR_RECORDING
from solver_backend.io.footage.recording import count_recordings
from solver_backend.io.markers.unsupported import name_unsupported_file
from solver_backend.io.motions.amass import AmassClip
from solver_backend.io.motions.bvh import BvhClip
from solver_backend.io.reader import Reader, ReadOptions
from solver_backend.io.recognition.camera_names import listing
from solver_backend.io.recognition.frame_choice import cut_frames
from solver_backend.io.recognition.motion_checks import checked_motion
from solver_backend.io.recognition.range_checks import checked
from solver_backend.io.registry import CAPTURES, MOTIONS
from solver_backend.types import Capture, Motion

Content = TypeVar("Content")
_NAMED = 5
"""Folders, or kinds of files, that an error names."""


def load_capture(path: Path | str, *, readers: Sequence[Reader[Capture]] = CAPTURES, **options: Any) -> Capture:
    """Read a capture and choose the person to solve.

    Args:
        path: file or folder.
        readers: asked in this order.
        options: fields of ``ReadOptions``.

    Returns:
        A capture that can be triangulated, with notes on what was assumed and problems the user should know.

    Raises:
        CaptureNotRecognised: no reader knows the path.
        JobInvalid: the frame rate is not positive, the take lacks the frames that are asked for, or a world without
            cameras is to be scaled or levelled.
        PersonUnknown: the capture does not show the person who was asked for.
        CalibrationInvalid, CaptureInvalid: its numbers cannot be, see ``range_checks``.
        MocapError: whatever else the reader raises.
    """
    path, chosen = Path(os.path.abspath(path)), ReadOptions(**options)
    reader = _reader_of(path, readers)
    if reader is None:
        raise _no_capture(path, readers)
    capture = reader.read(path, chosen)
    if chosen.frames is not None:
        capture = cut_frames(capture, *chosen.frames)
    if capture.cameras is None and chosen.changes_world:
        raise JobInvalid(
            "Stature, scale and level are for captures with cameras; this one has none.",
            where=str(path), hint="Scale a recording of markers by its unit: --unit.",
        )  # fmt: skip
    if chosen.person is not None:
        capture = capture.of_person(chosen.person)
    if capture.keypoints is not None:
        capture.require_views()
    capture = checked(capture)
    if capture.num_frames == 1:
        capture = replace(capture, problems=(*capture.problems, diagnostic("single_frame")))
    return capture


def load_motion(
    path: Path | str, *, readers: Sequence[Reader[Any]] = MOTIONS, **options: Any
) -> Motion | AmassClip | BvhClip:
    """Read a motion; a clip of another body or skeleton comes back as the file holds it.

    Args:
        path: file.
        readers: asked in this order.
        options: fields of ``ReadOptions``.

    Raises:
        MotionInvalid: no reader knows the path, or its numbers cannot be, see ``motion_checks``.
        MocapError: whatever else the reader raises.
    """
    path, chosen = Path(path), ReadOptions(**options)
    reader = _reader_of(path, readers)
    if reader is None:
        kinds = "; ".join(reader.kind for reader in readers)
        raise MotionInvalid("The path is not a readable motion.", where=str(path), hint=f"Motions are {kinds}.")
    motion = reader.read(path, chosen)
    checked_motion(motion, str(path))
    return motion


def _reader_of(path: Path, readers: Sequence[Reader[Content]]) -> Reader[Content] | None:
    return next((reader for reader in readers if reader.recognises(path)), None)


def _no_capture(path: Path, readers: Sequence[Reader[Capture]]) -> CaptureNotRecognised:
    hint = f"Captures are {'; '.join(reader.kind for reader in readers)}."
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
