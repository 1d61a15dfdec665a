"""One JSON file a picture, in a folder a camera or in one folder of all cameras, as OpenPose writes them."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.exchange.errors import FileDamaged
from solver_backend.io.detections.camera_frames import CameraFrames
from solver_backend.io.detections.named_points import are_named_frames, read_named_frames
from solver_backend.io.detections.picture_documents import hands_in_picture, people_in_picture
from solver_backend.io.files import LARGEST_TEXT, read_bytes
from solver_backend.io.recognition.frame_numbers import frame_numbers

_PADDING = re.compile(r"del_(\d{1,18})_\d+")
"""Files that Pose2Sim writes, without people, where a camera that it moved in time has no frame."""
_OWN_NAMES = "keypoints.json"
_FLAT = re.compile(r"(.*?[^\d_\-. ].*?)[_\-. ]+(\d{3,18})([_\-. ]*[A-Za-z]*)")
"""Camera and frame number in a file's name where all cameras share a folder: ``cam01_000000000012_keypoints``."""
_FLAT_NUMBER_FIRST = re.compile(r"(\d{3,18})[_\-. ]+(.*?[^\d_\-. ].*)")
"""The same with the number before the camera: ``000012_cam01``."""


LINES = ".jsonl", ".ndjson"
"""Endings of files that hold a JSON document on each line."""


def json_files(folder: Path) -> list[Path]:
    """Return the JSON files of a folder by name, without hidden ones and the user's names of keypoints."""
    with os.scandir(folder) as entries:
        names = [entry.name for entry in entries if _is_json(entry.name)]
    return [folder / name for name in sorted(names)]


def has_json_files(folder: Path) -> bool:
    """Return whether a folder holds any of ``json_files``, without listing thousands."""
    with os.scandir(folder) as entries:
        return any(_is_json(entry.name) for entry in entries)


def _is_json(name: str) -> bool:
    lower = name.lower()
    return lower.endswith(".json") and not name.startswith(".") and lower != _OWN_NAMES


def line_files(folder: Path) -> list[Path]:
    """Return the files of a folder that hold a JSON document on each line, by name, without hidden ones."""
    return sorted(p for p in folder.iterdir() if p.suffix.lower() in LINES and not p.name.startswith("."))


def cameras_of_flat_files(paths: Sequence[Path]) -> dict[str, list[Path]]:
    """Return the files of each camera where one folder holds all cameras; {} where names do not state camera and frame.

    A camera is what stands before the frame number, or after it. Every camera needs two files or more.
    """
    for pattern, group in ((_FLAT, 1), (_FLAT_NUMBER_FIRST, 2)):
        cameras: dict[str, list[Path]] = {}
        for path in paths:
            if (found := pattern.fullmatch(path.stem)) is None:
                break
            cameras.setdefault(found[group].rstrip("_-. "), []).append(path)
        else:
            if len(cameras) > 1 and min(map(len, cameras.values())) > 1:
                return cameras
    return {}


def frames_in_files(paths: Sequence[Path], where: str, numbered: Sequence[str] = ()) -> CameraFrames:
    """Return a camera's frames, one file each, by the number in its name; a padding file gives way to a frame.

    Args:
        paths: the files of one camera.
        where: their folder, for messages.
        numbered: names that hold their frame numbers; those of the files if left out.

    Raises:
        FileDamaged: there are none, or the names give no frame numbers.
    """
    if not paths:
        raise FileDamaged("The folder holds no JSON files.", where=where, hint="Put one file a frame there.")
    stems = numbered or [path.stem for path in paths]
    padded = [_PADDING.fullmatch(stem) for stem in stems]
    padding = {int(found[1]): path for path, found in zip(paths, padded, strict=True) if found}
    filmed = [(stem, path) for stem, path, found in zip(stems, paths, padded, strict=True) if not found]
    numbers = frame_numbers([stem for stem, _ in filmed], where=where).tolist()
    by_number = dict(zip(numbers, (path for _, path in filmed), strict=True))
    by_number = dict(sorted((padding | by_number).items()))
    files = tuple(by_number.values())
    if are_named_frames([read_document(path) for path in dict.fromkeys(files[:: max(len(files) // 2, 1)])]):
        frames, names = read_named_frames({n: read_document(path) for n, path in by_number.items()}, where)
        return CameraFrames.in_memory(frames, Path(where), names)

    @lru_cache(maxsize=1)
    def document(row: int) -> Any:
        return read_document(files[row])

    return CameraFrames(
        np.array(list(by_number), np.int64), lambda row: people_in_picture(document(row), str(files[row])),
        lambda row: str(files[row]), hands=lambda row: hands_in_picture(document(row), str(files[row])),
    )  # fmt: skip


def read_document(path: Path) -> Any:
    """Return what one picture's file holds.

    Raises:
        FileDamaged: the file is truncated or is not JSON.
    """
    data = read_bytes(path, LARGEST_TEXT)
    try:
        return json.loads(data)
    except (ValueError, RecursionError) as error:
        raise FileDamaged(
            f"The file is truncated or is not JSON ({error}).",
            where=str(path),
            hint="Export this frame again or delete the file.",
        ) from error
