"""Footage on disk: a video file or a numbered sequence of images."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

_VIDEOS = frozenset({".mp4", ".mov", ".avi", ".mkv", ".m4v", ".webm", ".mpg", ".mpeg", ".mts", ".wmv"})
_IMAGES = frozenset({".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".tga", ".webp"})


@dataclass(frozen=True)
class Footage:
    """What one camera saw."""

    files: tuple[Path, ...]
    """The video, or the images in order."""

    @property
    def is_video(self) -> bool:
        """Whether it is a video file."""
        return self.files[0].suffix.lower() in _VIDEOS


def find_footage(path: Path | None) -> Footage | None:
    """Return the footage at a path, or None where there is no video and no image.

    Args:
        path: a video, a folder of images, or None.
    """
    if path is None:
        return None
    if path.is_file() and path.suffix.lower() in _VIDEOS | _IMAGES:
        return Footage((path,))
    if path.is_dir():
        images = sorted((p for p in path.iterdir() if p.suffix.lower() in _IMAGES), key=_natural)
        return Footage(tuple(images)) if images else None
    return None


def _natural(path: Path) -> list[tuple[int, str]]:
    """Sort img_2 before img_10."""
    return [(int(part), "") if part.isdigit() else (0, part) for part in re.split(r"(\d+)", path.name.lower())]
