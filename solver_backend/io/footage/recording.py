"""Which files are one recording: a video, the chapters into which an action camera cut it, or a folder of pictures."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

from solver_backend.io.calibration.search import is_calibration_folder
from solver_backend.io.footage.footage import IMAGES, VIDEOS, footage_in
from solver_backend.io.recognition.camera_names import natural_key

_CHAPTER = re.compile(r"(?P<head>.*?)(?P<kind>G[HXP])(?P<chapter>\d\d)(?P<number>\d{4})(?P<tail>.*)", re.IGNORECASE)
"""GoPro's names: ``GX020101`` is chapter 2 of recording 0101; ``GH`` is H.264, ``GP`` that of cameras up to HERO5."""
_FIRST = re.compile(r"(?P<head>.*?)GOPR(?P<number>\d{4})(?P<tail>.*)", re.IGNORECASE)
"""The first chapter of cameras up to HERO5, which are followed by ``GP01``, ``GP02`` ..."""


def parts_of(path: Path) -> tuple[Path, ...]:
    """Return the files of a recording in their order: chapters beside its first, or the pictures of a folder.

    Args:
        path: a video, the first chapter of a recording, or a folder of pictures.
    """
    if path.is_dir():
        return tuple(sorted((p for p in path.iterdir() if is_picture(p)), key=lambda p: natural_key(p.name)))
    if chapter_of(path) is None or not path.parent.is_dir():
        return (path,)
    recordings = join_chapters(p for p in path.parent.iterdir() if p.suffix.lower() == path.suffix.lower())
    return next((parts for parts in recordings if parts[0] == path), (path,))


def count_recordings(root: Path) -> int:
    """Return how many recordings, chapters joined, lie in a folder and in the folders in it."""
    folders = [root, *sorted(path for path in root.iterdir() if path.is_dir())]
    found = [list(footage_in(folder).values()) for folder in folders if not is_calibration_folder(folder)]
    return sum(len(join_chapters(paths)) for paths in found)


def join_chapters(videos: Iterable[Path]) -> list[tuple[Path, ...]]:
    """Return the recordings of videos, each as its chapters in order; a chapter whose first is missing stands alone."""
    recordings: list[list[Path]] = []
    open_: dict[tuple[str, ...], list[Path]] = {}
    numbered = [(chapter_of(path), path) for path in sorted(videos, key=lambda p: natural_key(p.name))]
    for chapter, path in sorted(numbered, key=lambda item: -1 if item[0] is None else item[0][1]):
        if chapter is None:
            recordings.append([path])
            continue
        key, number = chapter
        begun = open_.get(key)
        if begun is not None and number == (chapter_of(begun[-1]) or (key, 0))[1] + 1:
            begun.append(path)
        else:
            open_[key] = [path]
            recordings.append(open_[key])
    return [tuple(parts) for parts in sorted(recordings, key=lambda parts: natural_key(parts[0].name))]


def chapter_of(path: Path) -> tuple[tuple[str, ...], int] | None:
    """Return which recording a video is a chapter of by its name, and which chapter; None for other names."""
    if found := _FIRST.fullmatch(path.stem):
        return (found["head"], "GP", found["number"], found["tail"], path.suffix.lower()), 0
    if found := _CHAPTER.fullmatch(path.stem):
        kind = found["kind"].upper()
        return (found["head"], kind, found["number"], found["tail"], path.suffix.lower()), int(found["chapter"])
    return None


def is_video(path: Path) -> bool:
    """Whether a path is named like a video that people keep."""
    return path.suffix.lower() in VIDEOS and path.is_file() and not path.name.startswith(".")


def is_picture(path: Path) -> bool:
    """Whether a path is named like a picture that people keep."""
    return path.suffix.lower() in IMAGES and not path.name.startswith(".")
