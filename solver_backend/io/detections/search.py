"""Find the detections of each camera in a recording folder."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NoReturn

from solver_backend.exchange.errors import CaptureNotRecognised, FileDamaged, MocapError
from solver_backend.io.calibration.search import CONFIG, holds_cameras
from solver_backend.io.calibration.yaml_storage import read_yaml
from solver_backend.io.camera_names import listing, natural_key
from solver_backend.io.detections import column_table, point_arrays
from solver_backend.io.detections.camera_frames import CameraFrames
from solver_backend.io.detections.json_documents import (
    LINES,
    cameras_in_document,
    cameras_of_flat_files,
    documents_in,
    frames_in_document,
    frames_in_files,
    has_json_files,
    is_take,
    json_files,
    line_files,
)
from solver_backend.io.files import first_bytes, read_text, read_toml
from solver_backend.types import JointSet


@dataclass(frozen=True)
class TakeFile:
    """A type of file that contains the detections of a whole take."""

    recognises: Callable[[Path], bool]
    """Function that recognises a file by its name or its first bytes."""
    camera: Callable[[Path], str]
    """Function that extracts the camera name from a file name."""
    read: Callable[[Path], CameraFrames]
    of_all: Callable[[Path], dict[str, Callable[[], CameraFrames]]] = lambda _: {}
    """Function that returns a reader for each camera in a file of several cameras, or {} for a single camera."""


_KINDS = (
    TakeFile(column_table.is_deeplabcut, column_table.deeplabcut_camera, column_table.read_deeplabcut),
    TakeFile(column_table.is_table, point_arrays.sleap_camera, column_table.read_table, column_table.cameras_in),
    TakeFile(
        column_table.has_point_rows,
        point_arrays.sleap_camera,
        column_table.read_point_rows,
        column_table.cameras_in_point_rows,
    ),
    TakeFile(point_arrays.is_sleap, point_arrays.sleap_camera, point_arrays.read_sleap),
    TakeFile(point_arrays.is_hdf5_table, column_table.deeplabcut_camera, point_arrays.read_hdf5_table),
    TakeFile(point_arrays.is_array, lambda path: path.stem, point_arrays.read_array, point_arrays.cameras_in),
)
"""File types, tried in this order. A folder contains files of one type."""
POSE_FOLDERS = ("pose-associated", "pose-sync", "pose", "pose-2d", "pose_sync")
"""Folders in a Pose2Sim trial that contain one folder per camera, last pipeline stage first."""
DETECTION_FOLDERS = (
    *POSE_FOLDERS,
    "annots",
    "predictions",
    "preds",
    "annotations",
    "keypoints",
    "detections",
    "labels",
)
"""Detection folders, also of EasyMocap, MMPose, MMDetection and COCO tools."""
BELOW = ("sep-json", "labels", "json", "keypoints", "predictions", "openpose", "pose")
"""Subfolders of a camera folder that contain its detections (AlphaPose, Ultralytics and others)."""
_LEVELS_BELOW = 2  # Largest depth of such subfolders, as in ``cam01/openpose/json``.
_ENDINGS = re.compile(
    r"([_\-. ](json|keypoints|openpose|openpifpaf|alphapose|predictions|labels)|\.(mp4|avi|mov|mkv))$", re.IGNORECASE
)
_STARTS = re.compile(r"^(results|predictions|alphapose|person_keypoints)[_\-. ]+", re.IGNORECASE)
_MOST_CAMERAS = 64
"""Largest number of files in a folder with one file per camera. More files mean one file per frame."""
_LOOKED_AT = 4096  # Number of bytes read to recognise the program that wrote a file.
_WHOLE = re.compile(
    r'"(instance_info|image_id|annotations|images|frames?|frame_(id|idx|index|number))"|"[^"]+\.(jpe?g|png)"\s*:'
)
_PERHAPS = re.compile(r'"people"|"[^"\\n]{1,60}"\s*:\s*(\[\s*-?\d|\{\s*"x")')
"""Pattern in the first bytes of files that may contain OpenPose documents or named points."""
_RUNS = tuple(f"{above}{run}*/labels" for above in ("", "pose/", "runs/", "runs/*/") for run in ("predict", "track"))
"""Folders with Ultralytics text files, such as ``runs/pose/predict/labels`` and ``runs/pose/predict2/labels``."""
_VIDEOS, _OUTPUT = "Videos", "OutputJsons*"
"""Folders in OpenCap's OpenPose pipeline: ``Videos/Cam0/OutputJsons_1x736/walk1/walk1_000000000000_keypoints.json``."""


@dataclass(frozen=True)
class CameraSource:
    """Location of one camera's detections."""

    path: Path  # Folder or file with the detections.
    frames: Callable[[], CameraFrames]  # Function that lists the frames. It raises our own errors.


def camera_sources(root: Path) -> dict[str, CameraSource]:
    """Find the detections of each camera in a recording. Return {} if there are none.

    The detections are in a folder that a known program creates, or in ``root`` itself. They consist of one folder or
    file per camera, or of files that contain all cameras. The search reads only names and the first bytes of tables.
    Cameras are in natural order.
    """
    if runs := _runs(root):
        return runs
    for parent in (folder for name in (*DETECTION_FOLDERS, "") if (folder := root / name).is_dir()):
        if found := _frame_folders(parent) or _folders(parent) or _camera_files(parent) or _flat_files(parent):
            return dict(sorted(found.items(), key=lambda item: natural_key(item[0])))
    return _array(root) or _opencap(root)


def of_folder(folder: Path) -> CameraSource:
    """Return the source of the detections in a camera folder with one file per image, or with a single file."""
    return CameraSource(folder, partial(_frames_of_folder, folder))


def _frames_of_folder(folder: Path) -> CameraFrames:
    paths = json_files(folder)
    if len(paths) == 1 and (whole := _whole_take(paths[0])) is not None:
        return whole
    return frames_in_files(paths, str(folder))


def _whole_take(path: Path, camera: str = "") -> CameraFrames | None:
    return frames_in_document(documents_in(read_text(path), path), path, camera)


def _frame_folders(parent: Path) -> dict[str, CameraSource]:
    """Find cameras in a folder with one subfolder per frame and one file per camera in each subfolder."""
    below = sorted((path for path in parent.iterdir() if path.is_dir()), key=lambda path: natural_key(path.name))
    if len(below) <= _MOST_CAMERAS or any(not any(c.isdigit() for c in path.name) for path in below):
        return {}
    names = [path.name for path in json_files(below[0])]
    cameras = {name: [folder / name for folder in below if (folder / name).is_file()] for name in names}
    if len(cameras) < 2 or len(cameras) > _MOST_CAMERAS or min(map(len, cameras.values())) <= len(below) // 2:
        return {}
    read = {n: partial(frames_in_files, p, str(parent), [f.parent.name for f in p]) for n, p in cameras.items()}
    return {camera_name(Path(name).stem): CameraSource(parent, frames) for name, frames in read.items()}


def _folders(parent: Path) -> dict[str, CameraSource]:
    below = [folder for folder in parent.iterdir() if folder.is_dir() and not holds_cameras(folder)]
    found = {camera_name(folder.name): source for folder in below if (source := _of_camera(folder, BELOW)) is not None}
    return found if set(found) - set(BELOW) else {}


def _of_camera(folder: Path, below: Sequence[str] = (), levels: int = _LEVELS_BELOW) -> CameraSource | None:
    """Find one camera's detections in its folder or in one of the subfolders ``below``, or return None."""
    if has_json_files(folder):
        return of_folder(folder)
    kind, files = take_files(folder) or (None, [])
    if kind is not None and len(files) == 1:
        return CameraSource(files[0], partial(kind.read, files[0]))
    if len(texts := column_table.files_of_cameras(folder)) == 1:
        return CameraSource(folder, partial(column_table.frames_of_files, next(iter(texts.values())), str(folder)))
    deeper = BELOW if levels > 1 else ()
    sources = (_of_camera(folder / name, deeper, levels - 1) for name in below if (folder / name).is_dir())
    return next((source for source in sources if source is not None), None)


def take_files(folder: Path) -> tuple[TakeFile, list[Path]] | None:
    """Return the first file type in ``_KINDS`` that a folder contains, with its files, or None if it contains none."""
    listed = sorted(p for p in folder.iterdir() if p.is_file())  # filtered tables sort last and take precedence
    for kind in _KINDS:
        if found := [path for path in listed if kind.recognises(path)]:
            return kind, found
    return None


def _camera_files(parent: Path) -> dict[str, CameraSource]:
    if (found := take_files(parent)) is not None:
        kind, files = found
        readers = kind.of_all(files[0]) if len(files) == 1 else {}
        if readers:
            return {name: CameraSource(files[0], reader) for name, reader in readers.items()}
        return {kind.camera(path): CameraSource(path, partial(kind.read, path)) for path in files}
    paths = [*json_files(parent), *line_files(parent)]
    if len(paths) > _MOST_CAMERAS or cameras_of_flat_files(paths):
        return {}
    paths = [path for path in paths if _is_whole_take(path)]  # other files are calibrations or settings
    if len(paths) != 1:
        return {camera_name(path.stem): CameraSource(path, partial(_take_of_camera, path)) for path in paths}
    names = cameras_in_document(documents_in(read_text(paths[0]), paths[0]))
    cameras = {name: name for name in names} or {camera_name(paths[0].stem): ""}
    return {name: CameraSource(paths[0], partial(_take_of_camera, paths[0], part)) for name, part in cameras.items()}


def _is_whole_take(path: Path) -> bool:
    if path.suffix.lower() in LINES:
        return True
    head = first_bytes(path, _LOOKED_AT).decode("utf-8", "replace")
    if _WHOLE.search(head) is not None:
        return True
    try:
        return _PERHAPS.search(head) is not None and is_take(documents_in(read_text(path), path))
    except MocapError:
        return True  # the reader reports the damage


def _take_of_camera(path: Path, camera: str = "") -> CameraFrames:
    if (whole := _whole_take(path, camera)) is None:
        hint = "Supported files: AlphaPose and COCO results, COCO annotations, MMPose and OpenPifPaf predictions."
        raise FileDamaged("The file does not contain the detections of a take.", where=str(path), hint=hint)
    return whole


def _flat_files(parent: Path) -> dict[str, CameraSource]:
    if cameras := cameras_of_flat_files(json_files(parent)):
        read = partial(frames_in_files, where=str(parent))
    else:
        cameras = column_table.files_of_cameras(parent)
        read = partial(column_table.frames_of_files, where=str(parent))
    return {camera_name(name): CameraSource(parent, partial(read, paths)) for name, paths in cameras.items()}


def _array(root: Path) -> dict[str, CameraSource]:
    if (path := point_arrays.find_array(root)) is None:
        return {}
    names = point_arrays.camera_names(root, path)
    return {name: CameraSource(path, partial(point_arrays.read_camera, path, c)) for c, name in enumerate(names)}


def _runs(root: Path) -> dict[str, CameraSource]:
    """Find the cameras in Ultralytics runs, by video name. If a video has several runs, its reader raises an error."""
    folders: dict[str, list[Path]] = {}
    for labels in sorted({path for pattern in _RUNS for path in root.glob(pattern)}, key=lambda p: natural_key(str(p))):
        for name in column_table.files_of_cameras(labels):
            folders.setdefault(name, []).append(labels)
    found = {}
    for name, places in sorted(folders.items(), key=lambda item: natural_key(item[0])):
        paths = column_table.files_of_cameras(places[0])[name]
        read = partial(column_table.frames_of_files, paths, str(places[0]))
        found[name] = CameraSource(places[0], read if len(places) == 1 else partial(_refuse_several, places))
    return found


def _opencap(root: Path) -> dict[str, CameraSource]:
    """Find the cameras in an OpenCap session. If it has several trials, the reader of a camera raises an error."""
    found, videos = dict[str, CameraSource](), root / _VIDEOS
    for camera in sorted(videos.iterdir(), key=lambda p: natural_key(p.name)) if videos.is_dir() else ():
        outputs = sorted(output for output in camera.glob(_OUTPUT) if output.is_dir()) if camera.is_dir() else ()
        trials = [folder for output in outputs for folder in sorted(output.iterdir()) if folder.is_dir()]
        trials = [folder for folder in trials if has_json_files(folder)]
        if len(trials) == 1:
            found[camera.name] = of_folder(trials[0])
        elif trials:
            found[camera.name] = CameraSource(trials[0], partial(_refuse_several, trials))
    return found


def _refuse_several(folders: Sequence[Path]) -> NoReturn:
    names = [f"{folder.parent.name}/{folder.name}" for folder in folders]
    hint = "Copy each camera's folder of one trial into a separate session."
    what = f"The session has several trials: {listing(names)}."
    raise CaptureNotRecognised(what, where=str(folders[0].parents[1]), hint=hint)


def camera_name(name: str) -> str:
    """Extract the camera name from a folder or file name, such as ``cam01`` from ``cam01_json``."""
    while (shorter := _ENDINGS.sub("", name)) not in ("", name):
        name = shorter
    return _STARTS.sub("", name) or name


def listed_paths(sources: Sequence[CameraSource]) -> tuple[str, ...]:
    """Return the files and folders of all sources without duplicates."""
    return tuple(dict.fromkeys(str(source.path) for source in sources))


_METADATA = "sessionMetadata.yaml"  # Metadata file in an OpenCap session.
SESSION_LEVELS = 3  # Depth of trials in a Pose2Sim session: session, participant, trial.
_POSE_MODELS = {joint_set.value: joint_set for joint_set in (JointSet.BODY_25, JointSet.BODY_25B, JointSet.COCO_17)}
_POSE_MODELS |= {"BODY": JointSet.COCO_17, "HALPE_26": JointSet.HALPE_26, "BODY_WITH_FEET": JointSet.HALPE_26}
_POSE_MODELS |= dict.fromkeys(("COCO_133", "WHOLE_BODY"), JointSet.COCO_WHOLEBODY_133)
_POSE_MODELS["BLAZEPOSE"] = JointSet.MEDIAPIPE_33


@dataclass(frozen=True)
class TrialConfig:
    """Settings of a recording in Pose2Sim and OpenCap files. Each value comes from the nearest file that states it."""

    fps: float | None = None  # Frames per second, or None if no file states a number.
    joint_set: JointSet | None = None  # Joint set that ``pose_model`` names, or None if unknown.
    frame_range: tuple[int, ...] = ()  # Frames that Pose2Sim processes, or empty for all frames.
    sources: tuple[str, ...] = ()  # Files that were read.
    rate_file: str = ""  # File that states the frame rate.


def trials_below(root: Path, levels: int = SESSION_LEVELS) -> list[str]:
    """List the paths of a session's trials, relative to the session folder."""
    found: list[str] = []
    for path in sorted((p for p in root.iterdir() if p.is_dir()), key=lambda p: natural_key(p.name)):
        if any((path / name).is_dir() for name in POSE_FOLDERS):
            found.append(path.name)
        elif levels > 1:
            found += [f"{path.name}/{trial}" for trial in trials_below(path, levels - 1)]
    return found


def read_config(levels: Sequence[Path]) -> TrialConfig:
    """Read a trial's settings from Pose2Sim's Config.toml and OpenCap's metadata."""
    config = TrialConfig()
    for path in (level / name for level in levels for name in (CONFIG, _METADATA) if (level / name).is_file()):
        tables = read_toml(path) if path.name == CONFIG else {"project": _of_opencap(path)}
        project, pose = (t if isinstance(t := tables.get(key), dict) else {} for key in ("project", "pose"))
        rate = positive_number(project.get("frame_rate"))
        config = TrialConfig(
            fps=rate if config.fps is None else config.fps,
            rate_file=str(path) if config.fps is None and rate is not None else config.rate_file,
            joint_set=config.joint_set or _POSE_MODELS.get(str(pose.get("pose_model")).upper()),
            frame_range=config.frame_range or _range(project.get("frame_range")),
            sources=(*config.sources, str(path)),
        )
    return config


def _of_opencap(path: Path) -> dict[str, Any]:
    with suppress(FileDamaged):  # another program may use the same file name
        if isinstance(values := read_yaml(path), dict):
            return {"frame_rate": values.get("framerate")}
    return {}


def positive_number(value: Any) -> float | None:
    """Return a TOML value as a frame rate, or None for 'auto' and invalid numbers."""
    good = isinstance(value, int | float) and not isinstance(value, bool) and 0 < value < 1e5
    return float(value) if good else None


def _range(value: Any) -> tuple[int, ...]:
    good = isinstance(value, list) and len(value) == 2 and all(isinstance(v, int) for v in value)
    return tuple(value) if good else ()
