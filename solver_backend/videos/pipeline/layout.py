"""Find takes, calibrations and board footage in a folder of videos by the names of its subfolders."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

from solver_backend.camera_calibration.boards.footage import board_cameras, entries, recordings_beside
from solver_backend.exchange.errors import CalibrationMismatch, CalibrationMissing, MocapError
from solver_backend.io.calibration.entry import Calibration
from solver_backend.io.calibration.search import find_calibration, is_calibration_folder
from solver_backend.io.footage import chapter_of, is_picture, is_video

_CAMERA_FOLDER = re.compile(r"(.*[_\-. ])?(cam(era)?|view|gopro|miqus|port|int_cam|c)?[_\-. ]*\d+", re.IGNORECASE)
"""Names of camera folders, which may each contain several videos: cam_01, Camera 2, view3, 04."""
_SOURCE_FOLDER = "inputmedia"  # OpenCap's subfolder for the footage of a camera.
_SYNCHRONISED = re.compile(r"[_\-. ]sync(ed|d|hronised|hronized)?$", re.IGNORECASE)
_MOST_PICTURE_NAMES = 64  # Maximum number of file names checked for images.


def _takes_by_folder(folders: Sequence[Path]) -> dict[str, dict[str, Path]]:
    """Group the footage in camera folders by take and camera. A single take has the name "".

    If every folder contains one recording, each folder is a camera. If folders have camera names, each may contain
    several recordings, one per take.
    """
    held = {folder.name: found for folder in folders if (found := _footage_in(folder))}
    if len(held) < 2:
        return {}
    if all(len(found) == 1 for found in held.values()):
        return {"": {camera: path for camera, found in held.items() for path in found.values()}}
    if not all(_CAMERA_FOLDER.fullmatch(camera) for camera in held):
        return {}
    takes: dict[str, dict[str, Path]] = {}
    for camera, found in held.items():
        for take, path in found.items():
            takes.setdefault(take, {})[camera] = path
    return {take: cameras for take, cameras in takes.items() if len(cameras) > 1}


def _footage_in(folder: Path) -> dict[str, Path]:
    """Find each take's recording in a camera folder. OpenCap has one subfolder per take."""
    for place in _folders(folder):
        if place.name.lower() == _SOURCE_FOLDER:
            found = dict(recordings_beside(place))
            for inner in _folders(place):
                recordings = recordings_beside(inner)
                synchronised = [path for stem, path in recordings.items() if _SYNCHRONISED.search(stem)]
                found.update((inner.name, path) for path in (synchronised or list(recordings.values()))[:1])
            if found:
                return found
    if found := recordings_beside(folder):
        return found
    return {folder.name: folder} if any(map(is_picture, entries(folder)[:_MOST_PICTURE_NAMES])) else {}


class NoVideos(MocapError):
    """The folder contains no videos that form a take."""


VIDEO_FOLDERS = (
    *("videos-sync", "videos_sync", "synchronized_videos", "synced_videos", "videos", "video"),
    *("recordings", "raw_videos", "videos_raw", "videosraw", "footage"),
)
"""Folders within a take that contain its videos, synchronised ones first (Pose2Sim, FreeMoCap, caliscope, anipose)."""
_PICTURE_FOLDERS = ("images", "frames")  # Folders within a take that contain one image folder per camera (EasyMocap).
_LEVELS = 4  # Number of folder levels searched for takes. Chosen by hand.
_INTRINSIC = re.compile(r"int(rinsics?)?([_\-\s].*)?|.*intrinsics?", re.IGNORECASE)
_EXTRINSIC = re.compile(r"ext(rinsics?)?([_\-\s].*)?|.*extrinsics?", re.IGNORECASE)
_PASSED_OVER = re.compile(r"pose.*|.*_json|detections|mocap.*|demo_.*|kinematics|output_data|annotated.*|\..*")


@dataclass(frozen=True)
class FoundTake:
    """A take: simultaneous recordings of one or more cameras."""

    name: str
    folder: Path
    videos: tuple[Path, ...]  # One per camera: a file, the first chapter of a recording, or an image folder.
    cameras: tuple[str, ...]  # Camera names, derived from the videos or their folders.

    def calibration(self, session: Path) -> Calibration | None:
        """Find the calibration of this take's cameras in its folder or in the session, or return None.

        Raises:
            CalibrationInvalid, FileDamaged: the nearest calibration is invalid.
            CalibrationMismatch: all calibrations belong to other cameras.
        """
        other: CalibrationMismatch | None = None
        names = [self.cameras]
        if all(map(chapter_of, self.videos)):
            names.append(tuple(name[-2:] for name in self.cameras))  # the numbers at their ends
        for root, tried in product((self.folder, session), names):
            try:
                return find_calibration(root, tried)
            except CalibrationMissing:
                continue
            except CalibrationMismatch as error:
                other = error
        if other is not None:
            raise other
        return None


@dataclass(frozen=True)
class CalibrationFootage:
    """Videos or images that show a calibration board."""

    kind: str  # 'intrinsics', 'extrinsics', or 'both' if the folder name does not tell.
    folder: Path
    cameras: dict[str, Path]


@dataclass(frozen=True)
class FoundFolder:
    """Takes and calibration footage found in a folder."""

    root: Path
    takes: tuple[FoundTake, ...]
    footage: tuple[CalibrationFootage, ...]


def look_through(root: Path) -> FoundFolder:
    """Find the takes and the board footage in a folder of videos.

    A video file, or a folder's only video, is a single-camera take. If there are multi-camera takes, single-camera
    takes are skipped.
    """
    if is_video(root) and root.is_file():
        takes, root = (FoundTake(root.stem, root.parent, (root,), (root.stem,)),), root.parent
    elif not root.is_dir():
        raise NoVideos("There is no such folder.", where=str(root), hint="Specify the folder with the videos.")
    else:
        takes = tuple(_takes(root, _LEVELS)) or _lone_take(root)
    if not takes:
        message = "The folder does not contain a take with one video per camera."
        hint = "Put one video per camera in a 'videos' folder, and board videos in 'calibration'. Chapters "
        one = (
            "such as GX010001 and GX020001 are one recording of one camera. To solve a single camera, give the "
            "video itself."
        )
        raise NoVideos(message, where=str(root), hint=hint + one)
    footage = {f.folder: f for start in (root, root.parent) for f in _footage(start, start is root)}
    return FoundFolder(root, takes, tuple(footage.values()))


def _takes(folder: Path, levels: int) -> Iterator[FoundTake]:
    below = {path.name.lower(): path for path in _folders(folder)}
    for name in (*VIDEO_FOLDERS, *_PICTURE_FOLDERS, "."):
        place = folder if name == "." else below.get(name)
        if place is None:
            continue
        own = folder.parent if name == "." and folder.name.lower() in VIDEO_FOLDERS else folder
        takes = {"": found} if len(found := recordings_beside(place)) >= 2 else _by_camera_folder(place)
        for take, cameras in takes.items():
            yield FoundTake(take or own.name, own, tuple(cameras.values()), tuple(cameras))
        if takes:
            return
    if levels > 0:
        for path in below.values():
            if not _is_other(path):
                yield from _takes(path, levels - 1)


def _lone_take(root: Path) -> tuple[FoundTake, ...]:
    """Return a take for the only video in a folder or in its video subfolder. Return () for none or several."""
    if _is_other(root):
        return ()
    below = {path.name.lower(): path for path in _folders(root)}
    places = [place for name in VIDEO_FOLDERS if (place := below.get(name)) is not None]
    found = [recordings_beside(place) for place in (*places, root)]
    videos = next((videos for videos in found if videos), {})
    return tuple(FoundTake(root.name, root, (path,), (name,)) for name, path in videos.items() if len(videos) == 1)


def _by_camera_folder(place: Path) -> dict[str, dict[str, Path]]:
    takes = _takes_by_folder([path for path in _folders(place) if not _is_other(path)])
    boards = [take for take in takes if take and (_kind(Path(take)) or is_calibration_folder(Path(take)))]
    return {take: cameras for take, cameras in takes.items() if take not in boards}


def _is_other(path: Path) -> bool:
    return is_calibration_folder(path) or bool(_PASSED_OVER.fullmatch(path.name)) or _kind(path) is not None


def _footage(folder: Path, deep: bool) -> Iterator[CalibrationFootage]:
    for path in _folders(folder):
        kind = _kind(path)
        if kind is None and not is_calibration_folder(path):
            continue
        inner = [(k, sub) for sub in _folders(path) if (k := _kind(sub))]
        for what, place in inner or [(kind or "both", path)]:
            if cameras := board_cameras(place, nested=False):
                yield CalibrationFootage(what, place, cameras)
    if deep:
        for path in _folders(folder):
            if not _is_other(path):
                yield from _footage(path, deep=False)


def _kind(path: Path) -> str | None:
    if _INTRINSIC.fullmatch(path.name):
        return "intrinsics"
    return "extrinsics" if _EXTRINSIC.fullmatch(path.name) else None


def _folders(folder: Path) -> list[Path]:
    return [path for path in entries(folder) if path.is_dir()]
