"""Which files of a folder are a camera's pictures of a board, for its lens and for where it stands."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from solver_backend.camera_calibration.frames import VIDEOS, is_footage
from solver_backend.exchange.errors import CaptureNotRecognised, FileMissing
from solver_backend.io.footage import join_chapters
from solver_backend.io.recognition.camera_names import natural_key

_LENS = ("intrinsics", "intrinsic", "lens", "lenses")
_EXTRINSIC = ("extrinsics", "extrinsic", "calibration", "board", "rig")  # the last is a word of users


@dataclass(frozen=True)
class BoardFootage:
    """Footage by the camera's name."""

    lens: dict[str, Path]
    """Of the board for each camera's lens; may be empty."""
    extrinsic: dict[str, Path]
    """Of the board seen by several cameras at once; may be empty."""


def board_footage(folder: Path) -> BoardFootage:
    """Return the footage of a folder: ``intrinsics/`` and ``extrinsics/`` in it or below, or its videos themselves.

    A camera is a video, a folder of pictures or of one video, or a folder with one such folder in it;
    ``int_cam01_img`` is camera ``cam01``, chapters of an action camera are one video.

    Raises:
        FileMissing: there is no such folder.
        CaptureNotRecognised: it holds no videos and no pictures.
    """
    if not folder.is_dir():
        raise FileMissing("There is no such folder.", where=str(folder))
    lens, extrinsic = _below(folder, _LENS), _below(folder, _EXTRINSIC)
    if not lens and not extrinsic:
        extrinsic = _cameras(folder)
    if not lens and not extrinsic:
        raise CaptureNotRecognised(
            "The folder holds no pictures of a board.",
            where=str(folder),
            hint="Put one video a camera into it, or into its folders intrinsics and extrinsics.",
        )
    return BoardFootage(lens, extrinsic)


def _below(folder: Path, names: tuple[str, ...], levels: int = 2) -> dict[str, Path]:
    folders = sorted(p for p in folder.iterdir() if p.is_dir())
    for path in folders:
        if path.name.lower() in names and (found := _cameras(path)):
            return found
    if levels > 1:
        for path in folders:
            if found := _below(path, names, levels - 1):
                return found
    return {}


def _cameras(folder: Path) -> dict[str, Path]:
    entries = sorted((p for p in folder.iterdir() if not p.name.startswith(".")), key=lambda p: natural_key(p.name))
    videos = join_chapters(path for path in entries if path.suffix.lower() in VIDEOS and path.is_file())
    found = {camera_name(parts[0]): parts[0] for parts in videos}
    for path in entries:
        if path.is_dir() and (footage := _footage_in(path)) is not None:
            found.setdefault(camera_name(path), footage)
    return found


def _footage_in(folder: Path) -> Path | None:
    """Return the pictures or the one video of a camera's folder, or those of the one folder in it that has any."""
    if is_footage(folder):
        return folder
    videos = join_chapters(path for path in folder.iterdir() if path.suffix.lower() in VIDEOS and path.is_file())
    if len(videos) == 1:
        return videos[0][0]
    inner = [path for path in sorted(folder.iterdir()) if path.is_dir() and is_footage(path)]
    return inner[0] if len(inner) == 1 else None


def camera_name(path: Path) -> str:
    """Return the camera's name in a file's or folder's name."""
    stem = path.stem if path.suffix.lower() in VIDEOS else path.name
    plain = re.sub(r"^(int|ext|intrinsics?|extrinsics?|calib)[_\-]", "", stem, flags=re.IGNORECASE)
    return re.sub(r"[_\-](img|imgs|int|ext|images|calib)$", "", plain, flags=re.IGNORECASE) or stem
