"""Raise errors for unsupported paths. They name the type of the file and a remedy."""

from __future__ import annotations

import fnmatch
import os
from collections import Counter
from collections.abc import Iterable
from itertools import islice
from pathlib import Path

from solver_backend.exchange.errors import CaptureNotRecognised
from solver_backend.exchange.outputs import require_path
from solver_backend.io.camera_names import listing
from solver_backend.io.detections.search import DETECTION_FOLDERS, camera_sources, trials_below
from solver_backend.io.footage import SENSOR_RECORDING, count_recordings, is_picture, is_video
from solver_backend.io.packed_values import SUFFIXES as PACKED
from solver_backend.io.reader import Reader
from solver_backend.io.text_table import delimiter_of, is_number
from solver_backend.types import Capture

_NAMED = 5  # Largest number of folders or file types named in an error.
MOST_NAMES = 1000  # Largest number of names examined in a folder, chosen by hand.
_LINES, _LEAST_COLUMNS = 5, 8  # Table lines to examine, and numbers in each: two counts and two markers.
_BTS = ".rah .raw .ric .rif .ang .mom .pwr .gr1 .gr2 .emf .emg .emr"
_FILES = (
    (".trb", "binary tracks from Motion Analysis EVaRT or Cortex", "Export TRC or C3D from Cortex."),
    (".cap", "a Motion Analysis Cortex project", "Export TRC or C3D from Cortex."),
    (".tdf", "a BTS SMART recording", "Export C3D from SMART Tracker or SMART Analyzer."),
    (_BTS, "a BTS ELITE file", "Export C3D from the program that recorded it."),
    (".x1d .x2d .xcp .vsk .mp .trial", "part of a Vicon trial", "Choose the trial's .c3d."),
    (".tak", "an OptiTrack Motive take", "Export C3D or CSV from Motive."),
    (".qtm .qca", "a Qualisys Track Manager recording", "Export C3D or TSV from QTM."),
    (".mvn", "an Xsens MVN recording", "Export C3D, or MVNX for `motion convert`, from MVN."),
    (".bvh .mvnx .asf .amc", "a skeleton motion", "Use `motion convert`."),
    (".fbx .glb .gltf .vrm .vrma .blend", "a skeleton motion", "Use `blender motion convert`."),
    (" ".join(PACKED), "a network result", "Use `motion convert`."),
    (".npy", "an array that does not contain 3D points", "Use `motion convert` if a network wrote it."),
    (".mot .sto .osim", "an OpenSim file without markers", "Choose the TRC or C3D file with the recording."),
    (".xmove .xml", "an XML file", "Export C3D or TRC from the program that wrote it."),
    (".xlsx .xls .ods", "a spreadsheet", "Save the sheet as CSV or text. TRC and CSV files with tracks are supported."),
)
"""Suffixes, names and remedies for unsupported marker files."""
_JSON = "Export JSON or CSV from the program that wrote them, such as MMPose's inferencer with --pred-out-dir."
_CSV = "Write one CSV per camera as DeepLabCut does (scorer, bodyparts, coords, frames), or OpenPose's JSON files."
_MATRICES = "*_pose.yml *_pose.yaml *_pose.xml"
_DETECTIONS = (
    ("*.pkl *.pickle", "Python pickles, which can run code when they are opened", _JSON),
    ("*.mat", "MATLAB files", _CSV),
    (_MATRICES, "OpenPose matrices written by --write_keypoint", "Run OpenPose with --write_json FOLDER."),
    ("*.parquet", "Parquet tables", _CSV),
)
"""File name patterns, names and remedies for unsupported detections."""
_PACKED = (("*.zip *.gz *.7z *.rar *.tar *.tgz *.xz *.bz2", "archives", "Unpack them into one folder per camera."),)
"""File name patterns, names and remedies for archives, which any folder may contain."""


def no_capture(path: Path, readers: Iterable[Reader[Capture]]) -> CaptureNotRecognised:
    """Return the error for a path that no reader recognises, with the type of the file and a remedy."""
    require_path(path, "file or folder")
    what, hint = _name_folder(path) if path.is_dir() else _name_file(path)
    kinds = dict.fromkeys(reader.kind for reader in readers)
    return CaptureNotRecognised(what, where=str(path), hint=hint or f"Captures are {'; '.join(kinds)}.")


def _name_file(path: Path) -> tuple[str, str]:
    if is_video(path):
        return "The file is a video.", f"Use from-videos {path.name}, which detects keypoints and solves them."
    if is_picture(path):
        return (
            "The file is an image.",
            "Use from-videos, which solves videos, or folders with each camera's images.",
        )
    if path.is_file() and _is_table_without_header(path):
        what = "The file is not supported: a table of numbers without marker names or a frame rate."
        return what, "Export it again with its header (Nexus: labels and units), or as C3D."
    for suffixes, what, how in _FILES if path.is_file() else ():
        if path.suffix.lower() in suffixes.split():
            return f"The file is not supported: {what}.", how
    return "The path is not a readable capture.", ""


def _name_folder(path: Path) -> tuple[str, str]:
    if (path / SENSOR_RECORDING).is_file():
        what = "The folder was recorded by depth sensors. Its markers have not been detected yet."
        return what, f"Use sensors markers {path.name} --out {path.name}.npz"
    if trials := trials_below(path):
        return "The folder is not a recording, but contains several recordings.", f"Choose one: {listing(trials)}."
    folders = [path, *(path / name for name in DETECTION_FOLDERS)]
    if (known := _matching(folders, _DETECTIONS)) is not None:
        return known
    if (footage := count_recordings(path)) > 1:
        what = f"The folder contains videos or images from {footage} cameras, but no detections."
        return (
            what,
            "Use from-videos, which detects, synchronises, calibrates and solves (Capture from Videos in Blender).",
        )
    if deeper := [below.name for below in sorted(path.iterdir()) if below.is_dir() and camera_sources(below)]:
        what = f"The folder has no detections, but its subfolder {listing(deeper[:_NAMED])} does."
        return what, f"Choose {path / deeper[0]}."
    if (known := _matching(folders, _PACKED)) is not None:
        return known
    if footage:
        return (
            "The folder contains one camera's images, but no detections.",
            f"Use from-videos {path.name}, which can also solve a single camera.",
        )
    return f"The folder contains no supported detections: {_contents(path)}.", ""


def _contents(folder: Path) -> str:
    with os.scandir(folder) as entries:
        kinds = Counter("folders" if e.is_dir() else Path(e.name).suffix.lower() or "files" for e in entries)
    return listing(f"{count} {kind}" for kind, count in kinds.most_common(_NAMED)) if kinds else "it is empty"


def _matching(folders: Iterable[Path], formats: Iterable[tuple[str, str, str]]) -> tuple[str, str] | None:
    """Name the first unsupported detections in the folders, and how to convert them. Return None if there are none."""
    there = [folder for folder in folders if folder.is_dir()]
    below = [path for folder in there for path in sorted(folder.iterdir()) if path.is_dir()]
    names = [(folder, name.lower()) for folder in (*there, *below) for name in _few_names(folder)]
    for patterns, what, how in formats:
        for folder, name in names:
            if any(fnmatch.fnmatchcase(name, pattern) for pattern in patterns.split()):
                return f"The detections are not supported: {what} ({folder.name}/{name}).", how
    return None


def _few_names(folder: Path) -> list[str]:
    with os.scandir(folder) as entries:
        return sorted(entry.name for entry in islice(entries, MOST_NAMES))


def _is_table_without_header(path: Path) -> bool:
    if path.suffix.lower() not in (".csv", ".txt", ".tsv"):
        return False
    with path.open(encoding="utf-8", errors="replace") as file:
        lines = [line.rstrip("\r\n") for line in islice(file, _LINES) if line.strip()]
    rows = [line.split(delimiter_of(line)) for line in lines]
    widths = {len(row) for row in rows}
    numbers = all(not cell or is_number(cell.replace(",", ".")) for row in rows for cell in row)
    return len(widths) == 1 and min(widths) >= _LEAST_COLUMNS and numbers
