"""Detections of programs that are recognised but not supported, and how to convert them."""

from __future__ import annotations

import fnmatch
import os
from itertools import islice
from pathlib import Path

MOST_NAMES = 1000
"""Names of a folder that are looked at; chosen by hand."""

_FORMATS = (
    (
        "*.pkl", "Python pickles, which run code when they are read",
        "Export JSON or CSV from the program that wrote them, such as MMPose's inferencer with --pred-out-dir.",
    ),
    ("*.pickle", "Python pickles, which run code when they are read", "Export JSON or CSV from their program."),
    ("*.mat", "MATLAB files", "Write one CSV a camera as DeepLabCut does, or OpenPose's JSON, one file a frame."),
    *(
        (pattern, "OpenPose's matrices of --write_keypoint", "Run OpenPose with --write_json FOLDER.")
        for pattern in ("*_pose.yml", "*_pose.yaml", "*_pose.xml")
    ),
    ("*.parquet", "Parquet tables", "Write one CSV a camera as DeepLabCut does: scorer, bodyparts, coords, frames."),
)  # fmt: skip
"""Pattern of the files' names, what they are, and the way out."""
_PACKED = tuple(
    (f"*.{ending}", "packed files", "Unpack them, one folder a camera.")
    for ending in ("zip", "gz", "7z", "rar", "tar", "tgz", "xz", "bz2")
)
"""The same of archives, which may lie beside anything."""


def name_unsupported(folders: list[Path], *, packed: bool = False) -> tuple[str, str] | None:
    """Return what a folder's files are that are not supported, and how to convert them; None if there are none.

    Args:
        folders: that are looked into with those in them, the likeliest first.
        packed: look for archives instead.
    """
    there = [folder for folder in folders if folder.is_dir()]
    below = [path for folder in there for path in sorted(folder.iterdir()) if path.is_dir()]
    names = [(folder, name.lower()) for folder in (*there, *below) for name in _few_names(folder)]
    for pattern, what, how in _PACKED if packed else _FORMATS:
        found = next((f"{folder.name}/{name}" for folder, name in names if fnmatch.fnmatchcase(name, pattern)), None)
        if found is not None:
            return f"not supported: {what} ({found}).", how
    return None


def _few_names(folder: Path) -> list[str]:
    """Return the first names of a folder: pictures by the thousand are all alike."""
    with os.scandir(folder) as entries:
        return sorted(entry.name for entry in islice(entries, MOST_NAMES))
