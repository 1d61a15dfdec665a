"""Find the footage of a calibration board in folders, and detect the board in its images with OpenCV."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from solver_backend.camera_calibration.boards.board import Board, BoardDetector, BoardSighting
from solver_backend.camera_calibration.pictures import opencv
from solver_backend.exchange.errors import CaptureNotRecognised, FileDamaged, FileMissing
from solver_backend.exchange.progress import Progress
from solver_backend.io.camera_names import name_key, natural_key
from solver_backend.io.footage import VIDEOS, is_picture, is_video, join_chapters, parts_of

_LENS = ("intrinsics", "intrinsic", "lens", "lenses")
_EXTRINSIC = ("extrinsics", "extrinsic", "calibration", "board", "rig")  # The last one is a name that users choose.
_LEVELS = 2  # Number of folder levels searched for these folders.
Sightings = dict[int, BoardSighting]  # Sightings of the board in one camera's images, by frame number.


@dataclass(frozen=True)
class BoardFootage:
    """Video or image folder of each camera that filmed the board."""

    lens: dict[str, Path]
    extrinsic: dict[str, Path]  # Simultaneous footage from several cameras. May be empty.

    @property
    def moving(self) -> bool:
        """True if all extrinsic footage is video, so that delays between the cameras are possible."""
        return all(path.suffix.lower() in VIDEOS for path in self.extrinsic.values())


def board_footage(folder: Path) -> BoardFootage:
    """Find the footage in ``intrinsics/`` and ``extrinsics/``. Without these folders, use the videos in ``folder``."""
    if not folder.is_dir():
        raise FileMissing("There is no such folder.", where=str(folder))
    lens, extrinsic = (_below(folder, names, _LEVELS) for names in (_LENS, _EXTRINSIC))
    if not lens and not extrinsic:
        extrinsic = board_cameras(folder)
    if not lens and not extrinsic:
        hint = "Put one video per camera in it, or in its subfolders intrinsics and extrinsics."
        raise CaptureNotRecognised("The folder contains no images of a board.", where=str(folder), hint=hint)
    return BoardFootage(lens, extrinsic)


def _below(folder: Path, names: tuple[str, ...], levels: int) -> dict[str, Path]:
    folders = [path for path in entries(folder) if path.is_dir()]
    named = (board_cameras(path) for path in folders if path.name.lower() in names)
    deeper = (_below(path, names, levels - 1) for path in folders if levels > 1)
    return next(filter(None, named), None) or next(filter(None, deeper), {})


def board_cameras(folder: Path, *, nested: bool = True) -> dict[str, Path]:
    """Find the board footage of each camera in a folder.

    Each video is a camera. Each subfolder with images or a single video is a camera too. The chapters of an action
    camera form one video. The camera name comes from the file or folder name: ``int_cam01_img`` is camera ``cam01``.
    If two entries have the same camera name, only one is used.

    Args:
        nested: if a folder has no footage, use its only subfolder with images.
    """
    found = {_camera_name(path): path for path in recordings_beside(folder).values()}
    for path in entries(folder):
        name = _camera_name(path)
        if not path.is_dir() or name_key(name) in map(name_key, found):
            continue
        if (footage := _footage_in(path, nested)) is not None:
            found[name] = footage
    return found


def _footage_in(folder: Path, nested: bool) -> Path | None:
    if _has_pictures(folder):
        return folder
    inside = list(recordings_beside(folder).values())
    if nested and not inside:
        inside = [path for path in entries(folder) if path.is_dir() and _has_pictures(path)]
    return inside[0] if len(inside) == 1 else None


def _has_pictures(folder: Path) -> bool:
    return any(is_picture(path) for path in entries(folder))


def _camera_name(path: Path) -> str:
    stem = path.stem if path.suffix.lower() in VIDEOS else path.name
    plain = re.sub(r"^(int|ext|intrinsics?|extrinsics?|calib)[_\-]", "", stem, flags=re.IGNORECASE)
    return re.sub(r"[_\-](img|imgs|int|ext|images|calib)$", "", plain, flags=re.IGNORECASE) or stem


def recordings_beside(folder: Path) -> dict[str, Path]:
    """Find the video recordings in a folder. A recording is named after its first chapter file."""
    return {parts[0].stem: parts[0] for parts in join_chapters(filter(is_video, entries(folder)))}


def entries(folder: Path) -> list[Path]:
    """Return the paths in a folder that are not hidden, in natural order, or [] if the folder does not exist."""
    try:
        shown = [path for path in folder.iterdir() if not path.name.startswith(".")]
        return sorted(shown, key=lambda path: natural_key(path.name))
    except OSError:
        return []


def grey_frames(path: Path) -> Iterator[tuple[int, np.ndarray]]:
    """Yield each frame's number, starting at 0, and its grey image (H, W) uint8."""
    if not path.exists():
        raise FileMissing("The path is not a video, an image or a folder of images.", where=str(path))
    any_frame = False
    for item in _of_pictures(path) if path.is_dir() or is_picture(path) else _of_video(path):
        any_frame = True
        yield item
    if not any_frame:
        hint = "Play it in a video player, or export it again as MP4."
        raise FileDamaged("No image can be decoded.", where=str(path), hint=hint)


def _of_pictures(path: Path) -> Iterator[tuple[int, np.ndarray]]:
    cv2 = opencv()
    for number, file in enumerate(parts_of(path)):
        picture = cv2.imdecode(np.frombuffer(file.read_bytes(), np.uint8), cv2.IMREAD_GRAYSCALE)
        if picture is not None:
            yield number, picture


def _of_video(path: Path) -> Iterator[tuple[int, np.ndarray]]:
    cv2 = opencv()
    number = 0
    for part in parts_of(path):
        video = cv2.VideoCapture(str(part))
        try:
            while video.grab():
                good, picture = video.retrieve()
                if good:
                    yield number, cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
                number += 1
        finally:
            video.release()


def find_boards(path: Path, board: Board) -> tuple[Sightings, tuple[int, int]]:
    """Detect the board in every frame of the footage. Also return the image width and height."""
    detector = BoardDetector(board)
    found: Sightings = {}
    size = (0, 0)
    for number, picture in grey_frames(path):
        size = (picture.shape[1], picture.shape[0])
        if (sighting := detector.find(picture)) is not None:
            found[number] = sighting
    return found, size


def find_together(
    footage: BoardFootage, names: Sequence[str], board: Board, progress: Progress
) -> tuple[list[Sightings], list[tuple[int, int]]]:
    """Run ``find_boards`` on the extrinsic footage of each camera. A camera without footage has no sightings."""
    seen, sizes = [], []
    for done, name in enumerate(names):
        progress(f"Board before {name}", done, len(names))
        path = footage.extrinsic.get(name)
        sightings, size = ({}, (0, 0)) if path is None else find_boards(path, board)
        seen.append(sightings)
        sizes.append(size)
    return seen, sizes
