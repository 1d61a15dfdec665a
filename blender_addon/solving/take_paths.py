"""Paths of captures, takes and calibrated people, and reports of the steps from videos to a capture."""

from __future__ import annotations

import re
import zlib
from dataclasses import dataclass
from itertools import islice
from pathlib import Path, PurePosixPath
from typing import Any

from .._exchange.diagnostics import Diagnostic, read_diagnostics
from .._exchange.errors import MocapError
from .._exchange.plain_text import plain
from ..conventions.naming import next_number, next_path

_POSE_FOLDERS = frozenset({"pose-associated", "pose-sync", "pose", "pose-2d", "pose_sync"})
"""Names of the folder in a Pose2Sim trial that contains a folder per camera, as in the solver."""
MARKER_SUFFIXES = (".c3d", ".trc", ".csv", ".tsv")
"""Suffixes of marker recordings. One such file is a capture. Some programs also use .txt."""
_FORBIDDEN = re.compile(r'[<>:"/\\|?*\x00-\x1f]+')


@dataclass(frozen=True)
class TakeFiles:
    """Paths of a new take's motion, report and job file, and its number."""

    number: int
    motion: Path
    report: Path
    job: Path


def safe_name(name: str) -> str:
    """Replace characters that some systems do not allow in folder names. Letters of all scripts are allowed."""
    cleaned = _FORBIDDEN.sub("_", name).strip(" .")
    return cleaned or "capture"


def capture_folder(base: Path, source: Path) -> Path:
    """Return the folder for a capture's files. Its name contains a checksum of the source's path, to avoid clashes."""
    mark = zlib.crc32(str(source).encode("utf-8", "surrogatepass")) & 0xFFFF
    is_file = source.suffix.lower() in (".npz", ".txt", *MARKER_SUFFIXES)
    return base / f"{safe_name(source.stem if is_file else source.name)}_{mark:04x}"


def next_take(folder: Path) -> TakeFiles:
    """Return the files of the next take. The numbers of existing files are not reused."""
    number = next_number(folder, "take")
    stem = f"take_{number:02d}"
    return TakeFiles(number, folder / f"{stem}.npz", folder / f"{stem}.html", folder / f"{stem}.job.json")


def next_subject(folder: Path) -> Path:
    """Return the file of the next calibrated person. The numbers of existing files are not reused."""
    return next_path(folder, "subject", ".npz")


def capture_root(path: Path) -> Path:
    """Return the capture (a file or a folder) that a dropped file belongs to.

    Blender passes only the dropped files and never a folder. For a file that contains detections, a calibration or
    settings, the capture is its folder, or a parent folder that contains the detections of all cameras. Folders,
    capture files, marker recordings, and text files outside such folders are captures themselves.
    """
    if path.is_dir() or path.suffix.lower() in (".npz", *MARKER_SUFFIXES):
        return path
    around = (folder.parent if folder.name.lower() in _POSE_FOLDERS else folder for folder in path.parents[:2])
    alone = path if path.suffix.lower() == ".txt" else path.parent
    return next((folder for folder in around if _holds_cameras(folder)), alone)


def is_session(path: Path) -> bool:
    """Return whether a folder contains recordings without being a recording itself."""
    return path.is_dir() and not _holds_cameras(path) and bool(trials_below(path))


def trials_below(path: Path, levels: int = 3) -> list[Path]:
    """Return the recordings in a session folder, at most ``levels`` folders deep, sorted by name."""
    found: list[Path] = []
    for folder in _folders(path):
        if not _POSE_FOLDERS.isdisjoint(inner.name.lower() for inner in _folders(folder)):
            found.append(folder)
        elif levels > 1:
            found += trials_below(folder, levels - 1)
    return found


def _folders(path: Path) -> list[Path]:
    try:
        return sorted(folder for folder in path.iterdir() if folder.is_dir())
    except OSError:
        return []  # this folder is not readable


def _holds_cameras(folder: Path) -> bool:
    """Return whether a folder contains one detections folder per camera, directly or in its pose folder."""
    try:
        below = {path.name.lower(): path for path in folder.iterdir() if path.is_dir()}
    except OSError:
        return False  # this folder is not readable
    return not _POSE_FOLDERS.isdisjoint(below) or sum(map(_holds_frames, below.values())) > 1


def _holds_frames(folder: Path) -> bool:
    numbered = (path for path in folder.glob("*.json") if re.search(r"\d", path.stem))
    return len(list(islice(numbered, 2))) > 1


NAME = "road.json"
_FORMAT, _VERSION = "manifold_mocap_road", 2
_LARGEST = 1 << 20
"""Size limit of a report in bytes. Chosen by hand."""


@dataclass(frozen=True)
class RoadStep:
    """A finished step from videos to a capture, with its diagnostics and pictures."""

    name: str
    diagnostics: tuple[Diagnostic, ...]  # Diagnostics of the step.
    pictures: tuple[Path, ...]  # Pictures of the step that exist.


def read_road(folder: Path) -> tuple[RoadStep, ...]:
    """Return the finished steps from videos to a capture, in order. Pictures outside the folder are omitted."""
    from .._exchange.json_file import read_json_file  # registering must not load JSON

    path = folder / NAME
    try:
        values = read_json_file(path, _LARGEST)
    except MocapError:
        return ()
    if not isinstance(values, dict) or values.get("format") != _FORMAT or values.get("version") != _VERSION:
        return ()
    steps = values.get("steps")
    rows = [row for row in steps if isinstance(row, dict)] if isinstance(steps, list) else []
    names = [plain(str(row.get("step", ""))) for row in rows]
    pictures = [_pictures(folder, row.get("pictures")) for row in rows]
    return tuple(map(RoadStep, names, [read_diagnostics(row.get("diagnostics")) for row in rows], pictures))


def _pictures(folder: Path, value: Any) -> tuple[Path, ...]:
    inside = folder.resolve()
    named = [PurePosixPath(item) for item in value if isinstance(item, str)] if isinstance(value, list) else []
    paths = [(folder / name).resolve() for name in named if name.suffix == ".png"]
    return tuple(path for path in paths if path.is_relative_to(inside) and path.is_file())
