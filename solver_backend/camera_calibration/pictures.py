"""Read calibration pictures with OpenCV, from videos or folders."""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.exchange.errors import BackendMissing, FileDamaged, FileMissing
from solver_backend.io.camera_names import natural_key
from solver_backend.io.footage import parts_of


def opencv() -> Any:
    """Import ``cv2``. Raise ``BackendMissing`` if it is not installed. It belongs to the extra ``capture``."""
    try:
        return import_module("cv2")
    except ImportError as error:
        hint = "Install it with: pip install opencv-contrib-python-headless."
        raise BackendMissing("Pictures and videos are read by OpenCV, which is not installed.", hint=hint) from error


VIDEOS = (".mp4", ".mov", ".avi", ".mkv", ".m4v", ".webm")
PICTURES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")


def is_footage(path: Path) -> bool:
    """Return whether a path is a video, a picture, or a folder of pictures."""
    if path.is_dir():
        return any(p.suffix.lower() in PICTURES for p in path.iterdir())
    return path.suffix.lower() in (*VIDEOS, *PICTURES)


def grey_frames(path: Path, step: int = 1) -> Iterator[tuple[int, np.ndarray]]:
    """Yield the numbers of frames from 0, and their grey pictures (H, W) uint8.

    Args:
        step: step between the frames. Videos are decoded completely, because seeking is not exact.

    Raises:
        FileMissing: there is nothing at the path.
        FileDamaged: no picture can be decoded.
    """
    if not path.exists():
        raise FileMissing("There is no video, picture or folder of pictures here.", where=str(path))
    found = _of_pictures(path, step) if path.is_dir() or path.suffix.lower() in PICTURES else _of_video(path, step)
    any_frame = False
    for item in found:
        any_frame = True
        yield item
    if not any_frame:
        hint = "Play it in a video player, or export it again as MP4."
        raise FileDamaged("No picture can be decoded.", where=str(path), hint=hint)


def _of_pictures(path: Path, step: int) -> Iterator[tuple[int, np.ndarray]]:
    cv2 = opencv()
    files = [path]
    if path.is_dir():
        pictures = (p for p in path.iterdir() if p.suffix.lower() in PICTURES)
        files = sorted(pictures, key=lambda p: natural_key(p.name))
    for number, file in enumerate(files[::step]):
        picture = cv2.imdecode(np.frombuffer(file.read_bytes(), np.uint8), cv2.IMREAD_GRAYSCALE)
        if picture is not None:
            yield number * step, picture


def _of_video(path: Path, step: int) -> Iterator[tuple[int, np.ndarray]]:
    cv2 = opencv()
    number = 0
    for part in parts_of(path):
        video = cv2.VideoCapture(str(part))
        try:
            while video.grab():
                if number % step == 0:
                    good, picture = video.retrieve()
                    if good:
                        yield number, cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
                number += 1
        finally:
            video.release()
