"""What a folder of videos holds, told by its folders' names: takes, calibrations and footage to calibrate from."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from solver_backend.exchange.errors import CalibrationMismatch, CalibrationMissing
from solver_backend.io.calibration import Calibration
from solver_backend.io.calibration.search import find_calibration, is_calibration_folder
from solver_backend.io.footage.footage import IMAGES, VIDEOS
from solver_backend.io.recognition.camera_names import name_key, natural_key
from solver_backend.videos.pipeline.errors import NoVideos

VIDEO_FOLDERS = (
    "videos-sync", "videos_sync", "synchronized_videos", "synced_videos", "videos", "video", "recordings",
    "raw_videos", "videos_raw", "videosraw", "footage",
)  # fmt: skip
"""Folders of a take that hold its videos; synchronised ones come first (Pose2Sim, FreeMoCap, caliscope, anipose)."""
_LEVELS = 4
_INTRINSIC = re.compile(r"int(rinsics?)?([_\-\s].*)?|.*intrinsics?", re.IGNORECASE)
_EXTRINSIC = re.compile(r"ext(rinsics?)?([_\-\s].*)?|.*extrinsics?", re.IGNORECASE)
_PASSED_OVER = re.compile(r"pose.*|.*_json|detections|mocap.*|demo_.*|kinematics|output_data|annotated.*|\..*")


@dataclass(frozen=True)
class FoundTake:
    """A take: videos of several cameras."""

    name: str
    """Name of its folder."""
    folder: Path
    """The take's own folder."""
    videos: tuple[Path, ...]
    """One a camera, in natural order."""

    @property
    def cameras(self) -> tuple[str, ...]:
        """Names of the cameras, those of the videos."""
        return tuple(path.stem for path in self.videos)

    def calibration(self, session: Path) -> Calibration | None:
        """Return the calibration that knows this take's cameras: from its folders, or from the session's; or None.

        Raises:
            CalibrationInvalid, FileDamaged: the nearest one is bad.
            CalibrationMismatch: there are some, all of other cameras.
        """
        other: CalibrationMismatch | None = None
        for root in (self.folder, session):
            try:
                return find_calibration(root, self.cameras)
            except CalibrationMissing:
                continue
            except CalibrationMismatch as error:
                other = error
        if other is not None:
            raise other
        return None


@dataclass(frozen=True)
class CalibrationFootage:
    """Videos or pictures of a board."""

    kind: str
    """'intrinsics', 'extrinsics', or 'both' where the folder does not say."""
    folder: Path
    """Where they are."""
    cameras: dict[str, Path]
    """By camera: a video, or a folder of pictures."""


@dataclass(frozen=True)
class FoundFolder:
    """What a folder holds."""

    root: Path
    """The folder."""
    takes: tuple[FoundTake, ...]
    """Recordings of people."""
    footage: tuple[CalibrationFootage, ...]
    """Recordings of boards."""


def look_through(root: Path) -> FoundFolder:
    """Return the takes and the calibration footage of a folder; takes of one camera are passed over.

    Raises:
        NoVideos: the folder is not there, or holds no take of two cameras.
    """
    if not root.is_dir():
        raise NoVideos("There is no such folder.", where=str(root), hint="Name the folder that holds the videos.")
    takes = tuple(_takes(root, _LEVELS))
    if not takes:
        raise NoVideos(
            "The folder holds no take: videos of two cameras or more side by side.", where=str(root),
            hint="Put one video a camera into a folder 'videos', and those of the board into 'calibration'.",
        )  # fmt: skip
    footage = {f.folder: f for start in (root, root.parent) for f in _footage(start, start is root)}
    return FoundFolder(root, takes, tuple(footage.values()))


def _takes(folder: Path, levels: int) -> Iterator[FoundTake]:
    below = {path.name.lower(): path for path in _folders(folder)}
    for name in (*VIDEO_FOLDERS, "."):
        place = folder if name == "." else below.get(name)
        if place is not None and len(videos := _videos(place)) >= 2:
            own = folder.parent if name == "." and folder.name.lower() in VIDEO_FOLDERS else folder
            yield FoundTake(own.name, own, videos)
            return
    if levels > 0:
        for path in below.values():
            if not (is_calibration_folder(path) or _PASSED_OVER.fullmatch(path.name) or _kind(path)):
                yield from _takes(path, levels - 1)


def _footage(folder: Path, deep: bool) -> Iterator[CalibrationFootage]:
    """Yield the footage of boards: of folders named for it, and one level below those."""
    for path in _folders(folder):
        kind = _kind(path)
        if kind is None and not is_calibration_folder(path):
            continue
        inner = [(k, sub) for sub in _folders(path) if (k := _kind(sub))]
        for what, place in inner or [(kind or "both", path)]:
            if cameras := _cameras(place):
                yield CalibrationFootage(what, place, cameras)
    if deep:
        for path in _folders(folder):
            if not (is_calibration_folder(path) or _PASSED_OVER.fullmatch(path.name) or _kind(path)):
                yield from _footage(path, deep=False)


def _kind(path: Path) -> str | None:
    if _INTRINSIC.fullmatch(path.name):
        return "intrinsics"
    return "extrinsics" if _EXTRINSIC.fullmatch(path.name) else None


def _cameras(folder: Path) -> dict[str, Path]:
    found = {" ".join(name_key(path.stem)): path for path in _videos(folder)}
    for path in _folders(folder):
        if any(item.suffix.lower() in IMAGES + VIDEOS for item in path.iterdir()):
            found.setdefault(" ".join(name_key(path.name)), path)
    return found


def _videos(folder: Path) -> tuple[Path, ...]:
    if not folder.is_dir():
        return ()
    found = [p for p in folder.iterdir() if p.suffix.lower() in VIDEOS and p.is_file() and not p.name.startswith(".")]
    return tuple(sorted(found, key=lambda p: natural_key(p.name)))


def _folders(folder: Path) -> list[Path]:
    try:
        return sorted((p for p in folder.iterdir() if p.is_dir()), key=lambda p: natural_key(p.name))
    except OSError:
        return []
