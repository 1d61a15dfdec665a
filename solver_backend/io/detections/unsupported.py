"""Detections of programs that are recognised but not supported, and how to convert them."""

from __future__ import annotations

import fnmatch
from pathlib import Path

_FORMATS = (
    (
        "*.pkl", "Python pickles, which run code when they are read",
        "Export JSON or CSV from the program that wrote them, such as MMPose's inferencer with --pred-out-dir.",
    ),
    ("*.pickle", "Python pickles, which run code when they are read", "Export JSON or CSV from their program."),
    ("*.mat", "MATLAB files", "Write one CSV a camera as DeepLabCut does, or OpenPose's JSON, one file a frame."),
    ("*.parquet", "Parquet tables", "Write one CSV a camera as DeepLabCut does: scorer, bodyparts, coords, frames."),
)  # fmt: skip
"""Pattern of the files' names, what they are, and the way out."""


def name_unsupported(folders: list[Path]) -> tuple[str, str] | None:
    """Return what a folder's files are that are not supported, and how to convert them; None if there are none.

    Args:
        folders: that are looked into, the likeliest first.
    """
    names = [(folder, path.name.lower()) for folder in folders if folder.is_dir() for path in sorted(folder.iterdir())]
    for pattern, what, how in _FORMATS:
        found = next((f"{folder.name}/{name}" for folder, name in names if fnmatch.fnmatchcase(name, pattern)), None)
        if found is not None:
            return f"not supported: {what} ({found}).", how
    return None
