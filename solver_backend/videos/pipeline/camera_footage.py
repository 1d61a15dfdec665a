"""The footage of each camera in a folder: videos side by side, or a folder a camera with videos or pictures."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from solver_backend.io.footage import is_picture, is_video, join_chapters
from solver_backend.io.recognition.camera_names import natural_key

_CAMERA_FOLDER = re.compile(r"(.*[_\-. ])?(cam(era)?|view|gopro|miqus|port|int_cam|c)?[_\-. ]*\d+", re.IGNORECASE)
"""Names of folders that are a camera even where they hold several videos: cam_01, Camera 2, view3, 04."""
_SOURCE_FOLDERS = ("inputmedia", "")
"""Where a camera's own footage lies in its folder: OpenCap's, or directly."""
_SYNCHRONISED = re.compile(r"[_\-. ]sync(ed|d|hronised|hronized)?$", re.IGNORECASE)
_MOST_PICTURE_NAMES = 64
"""Names that are looked at to see whether a folder holds pictures."""


def recordings_beside(folder: Path) -> dict[str, Path]:
    """Return the recordings of a folder by name: videos side by side, of an action camera's chapters the first."""
    videos = [path for path in _entries(folder) if is_video(path)]
    return {parts[0].stem: parts[0] for parts in join_chapters(videos)}


def recordings_by_folder(folders: Sequence[Path]) -> dict[str, dict[str, Path]]:
    """Return the footage of camera folders: by take, then by camera; a take's name is "" where each has one alone.

    Folders are cameras where each holds one recording, or where they are named like cameras and hold several, whose
    names are the takes'.
    """
    held = {folder.name: found for folder in folders if (found := _footage_in(folder))}
    if len(held) < 2:
        return {}
    if all(len(found) == 1 for found in held.values()):
        return {"": {camera: next(iter(found.values())) for camera, found in held.items()}}
    if not all(_CAMERA_FOLDER.fullmatch(camera) for camera in held):
        return {}
    names = dict.fromkeys(take for found in held.values() for take in found)
    takes = {take: {camera: found[take] for camera, found in held.items() if take in found} for take in names}
    return {take: cameras for take, cameras in takes.items() if len(cameras) > 1}


def _footage_in(folder: Path) -> dict[str, Path]:
    """Return the recordings of one camera's folder by take; pictures directly in it are one."""
    below = {path.name.lower(): path for path in _entries(folder) if path.is_dir()}
    for name in _SOURCE_FOLDERS:
        place = folder if not name else below.get(name)
        if place is None:
            continue
        found = dict(recordings_beside(place))
        for inner in (path for path in _entries(place) if path.is_dir() and name):
            found.update((inner.name, path) for path in _preferred(recordings_beside(inner)))
        if found:
            return found
        if any(is_picture(path) for path in _entries(folder)[:_MOST_PICTURE_NAMES]):
            return {folder.name: folder}
    return {}


def _preferred(found: dict[str, Path]) -> list[Path]:
    """Return the one recording of a take's folder: the synchronised where there are several."""
    chosen = [path for stem, path in found.items() if _SYNCHRONISED.search(stem)] or list(found.values())
    return chosen[:1]


def _entries(folder: Path) -> list[Path]:
    try:
        return sorted(folder.iterdir(), key=lambda p: natural_key(p.name))
    except OSError:
        return []
