"""Read detections from JSON documents that describe one image or a whole take."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import lru_cache
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from solver_backend.exchange.errors import FileDamaged, KeypointCountMismatch
from solver_backend.exchange.joint_sets import NUM_HAND_POINTS, SIDES
from solver_backend.exchange.json_file import parse_json
from solver_backend.io.detections.camera_frames import CameraFrames, Hands, People
from solver_backend.io.files import read_json
from solver_backend.io.recognition.frame_numbers import frame_numbers

# The points of one person from OpenPose, EasyMocap, MMPose, Sapiens or OpenPifPaf, or as objects.
_OPENPOSE = ("pose_keypoints_2d", "pose_keypoints")  # Keys of the body points in OpenPose, current and version 1.0.
_OPENPOSE_HANDS = (("hand_{}_keypoints_2d", "hand_{}_keypoints"), ("handl2d", "handr2d"))
"""Keys of the hand points in OpenPose (current and version 1.0, for each side) and in EasyMocap (left, right)."""
_HAND_LISTS = tuple(
    (*(name.format(side) for name in _OPENPOSE_HANDS[0]), _OPENPOSE_HANDS[1][s]) for s, side in enumerate(SIDES)
)
"""Possible keys of the hand points, for each side."""
_LISTS = ("instances", "instance_info", "predictions", "poses", "persons", "people", "detections")
"""Keys under which programs store the list of people."""
_POINTS = ("keypoints", "pose_keypoints_2d", "landmarks", "pose_landmarks", "poseLandmarks", "joints", "joints2d")
_POINTS += ("keypoints2d", "keypoints_2d", "kpts")
_SCORES = ("keypoint_scores", "keypoints_scores", "scores")
"""Keys of a person's points, and keys of the list of their scores."""
_SCORE = ("score", "confidence", "visibility", "likelihood", "conf", "c", "v", "p")
"""Keys of a point's score if the point is an object with x and y, as in MediaPipe and MoveNet."""
_BOXES = ("bboxes", "labels")  # Keys of an image in MMDetection files.


def _triples(values: object, name: str, where: str) -> np.ndarray:
    """Convert 3 K numbers, or K triples, to points (K, 3). ``name`` is the key, for errors."""
    if not isinstance(values, list):
        raise FileDamaged(f"A person in the file has no '{name}'.", where=where)
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise FileDamaged(f"'{name}' contains values that are not numbers.", where=where) from error
    if array.size % 3 or (array.ndim == 2 and array.shape[1] != 3) or array.ndim > 2:
        what = f"'{name}' contains {array.size} numbers, but x, y and confidence of each keypoint are expected."
        raise KeypointCountMismatch(what, where=where)
    return array.reshape(-1, 3)


def _are_point_objects(values: object) -> bool:
    return isinstance(values, list) and bool(values) and isinstance(values[0], dict) and {"x", "y"} <= values[0].keys()


def _object_point(point: Mapping[str, Any]) -> tuple[Any, Any, Any]:
    return point["x"], point["y"], next((point[name] for name in _SCORE if name in point), 1.0)


def _person(entry: Any, where: str) -> np.ndarray:
    """Read a person's points (K, 3) from triples, from objects, or from points and a list of scores."""
    if not isinstance(entry, dict):
        hint = "Export the detections again, with an object for each person."
        raise FileDamaged("A person in the file is not a JSON object.", where=where, hint=hint)
    points = _points_of(entry)
    if isinstance(points, list) and not points:
        return np.zeros((0, 3))
    if _are_point_objects(points):
        try:
            return np.array([_object_point(point) for point in points], dtype=np.float64).reshape(-1, 3)
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise FileDamaged("A point in the file has no x or y, or they are not numbers.", where=where) from error
    scores = next((entry[name] for name in _SCORES if name in entry), None)
    if scores is None:
        return _triples(points, "keypoints", where)
    try:
        xy, confidence = np.array(points, dtype=np.float64), np.array(scores, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise FileDamaged("'keypoints' or 'keypoint_scores' contains non-numeric values.", where=where) from error
    if xy.ndim != 2 or xy.shape[1] < 2 or confidence.shape != (len(xy),):
        what = (
            f"'keypoints' has the shape {xy.shape} and 'keypoint_scores' {confidence.shape}, but K points and K scores "
        )
        raise KeypointCountMismatch(f"{what}are expected.", where=where)
    return np.column_stack([xy[:, :2], confidence])


def _points_of(entry: dict[str, Any]) -> Any:
    """Return a person's points, or None for other entries, such as a box from MMPose."""
    points = next((entry[name] for name in _POINTS if name in entry), None)
    return points if isinstance(points, list) else None


def _names_in(entry: dict[str, Any]) -> tuple[str, ...]:
    """Return the names of a person's points, or () if they have no names."""
    points = _points_of(entry)
    if not _are_point_objects(points):
        return ()
    names = [point.get("name", point.get("part")) if isinstance(point, dict) else None for point in points]
    return tuple(map(str, names)) if all(names) else ()


# Documents that describe one image.
def people_in_picture(document: Any, where: str) -> People:
    """Read everyone in a document that describes one image.

    Raises:
        KeypointCountMismatch: the length of a keypoint list is not a multiple of three.
    """
    values = document if isinstance(document, dict) else {}
    if document is None or values.get("people", ...) is None:
        return []
    if isinstance(people := values.get("people"), list) and not _are_listed(people):
        return _kept(_openpose_person(entry, where) for entry in people)
    if isinstance(people := values.get("annots"), list):
        entries = (entry.get("keypoints") if isinstance(entry, dict) else None for entry in people)
        return _kept(_triples(entry, "keypoints", where) for entry in entries)
    if (people := listed_people(document)) is not None:
        return _kept(_person(entry, where) for entry in people)
    if all(name in values for name in _BOXES):
        hint = "Run a pose estimator on the images, such as MMPose's inferencer with --pred-out-dir."
        what = "The file has only boxes, as MMDetection writes them, and no keypoints."
        raise FileDamaged(what, where=where, hint=hint)
    hint = (
        "Other supported formats are EasyMocap's 'annots', MMPose's instances with 'keypoints' and "
        "'keypoint_scores', OpenPifPaf's "
    )
    hint += "predictions, and points that are objects with x, y and score."
    raise FileDamaged("The file has no OpenPose list 'people'.", where=where, hint=hint)


def _kept(people: Iterable[np.ndarray | None]) -> People:
    return [person for person in people if person is not None and len(person)]


def _are_listed(people: list[Any]) -> bool:
    """Return whether all people have points in a known format other than OpenPose's."""
    return bool(people) and all(
        isinstance(entry, dict) and not any(name in entry for name in _OPENPOSE) and _points_of(entry) is not None
        for entry in people
    )


def _is_openpose(document: Any) -> bool:
    """Return whether a document is an OpenPose image. Its people have OpenPose's keys or are ``{}``."""
    people = document.get("people") if isinstance(document, dict) else None
    return isinstance(people, list) and all(
        isinstance(entry, dict) and (not entry or any(name in entry for name in _OPENPOSE)) for entry in people
    )


def _openpose_person(entry: Any, where: str) -> np.ndarray | None:
    """Return a person's points (K, 3), or None for ``{}``, which Pose2Sim writes for an unmatched person."""
    if entry == {}:
        return None
    if not isinstance(entry, dict):
        raise FileDamaged(f"A person in the file has no '{_OPENPOSE[0]}'.", where=where)
    name = next((name for name in _OPENPOSE if name in entry), _OPENPOSE[0])
    return _triples(entry.get(name), name, where)


def listed_people(document: Any) -> list[Any] | None:
    """Return the list of people in a document if all have a known format, otherwise None.

    The list is the document itself or a value in it (``instances`` in MMPose, ``predictions`` in OpenPifPaf, ``poses``
    in MoveNet). A document may also describe one person (``landmarks`` in MediaPipe).
    """
    if isinstance(document, dict):
        if (several := _several(document)) is not None:
            return several
        if _points_of(document) is not None:
            return [document]
        document = next((document[name] for name in _LISTS if isinstance(document.get(name), list)), None)
    if not isinstance(document, list) or not all(isinstance(e, dict) and _points_of(e) is not None for e in document):
        return None
    return document


def _several(document: dict[str, Any]) -> list[Any] | None:
    """Split points (P, K, 2) and scores (P, K) of P people into one entry per person. Return None for other content."""
    people = _points_of(document)
    if not people or not all(isinstance(person, list) and person for person in people):
        return None
    if not all(isinstance(point, list) for point in people[0]):
        return None
    name = next((name for name in _SCORES[:-1] if name in document), None)
    scores = document[name] if name is not None else [[1.0] * len(person) for person in people]
    if not isinstance(scores, list) or len(scores) != len(people):
        return None
    if len(people[0][0]) == 3 and name is None:
        return [{_POINTS[0]: person} for person in people]
    return [{_POINTS[0]: person, _SCORES[0]: of_each} for person, of_each in zip(people, scores, strict=True)]


def _hands_in_picture(document: Any, where: str) -> Hands:
    """Read everyone's hands in a document that describes one image, in the order of ``people_in_picture``."""
    entries = (document.get("people", document.get("annots")) or ()) if isinstance(document, dict) else ()
    people = (entry for entry in entries if isinstance(entry, dict))
    return [_hands(entry, where) for entry in people if any(entry.get(name) for name in (*_OPENPOSE, "keypoints"))]


def _hands(entry: dict[str, Any], where: str) -> np.ndarray | None:
    names = [next((name for name in names if entry.get(name)), "") for names in _HAND_LISTS]
    if not any(names):
        return None
    hands = np.zeros((len(SIDES), NUM_HAND_POINTS, 3))
    for s, name in enumerate(names):
        points = _triples(entry[name], name, where) if name else hands[s]
        if len(points) != NUM_HAND_POINTS:
            what = f"'{name}' contains {len(points)} points, but a hand has {NUM_HAND_POINTS}."
            raise KeypointCountMismatch(what, where=where)
        hands[s] = points
    return hands


# Documents whose points have names.
_LEAST = 5  # A file is recognised if its largest person has at least this number of points.
_PERSON, _PEOPLE = ("keypoints", "landmarks", "points", "joints", "pose"), ("people", "persons", "instances", "poses")
"""Keys of a person's points, and keys of the list of people in a frame."""
_NUMBERED = re.compile(r"(?:.*\D)?(\d{1,18})(\.\w+)?")
"""Frame name, such as ``12``, ``frame_000012`` or ``000012.jpg``."""
_Named = Mapping[str, Any]
"""A person's points by name: x, y and an optional score as a list or an object, or null if undetected."""


def _named_people(frame: Any) -> list[_Named] | None:
    """Return the people in a frame if their points have names, or None for other content."""
    if frame is None or frame in ({}, []):
        return []
    if isinstance(frame, dict) and isinstance(listed := next((frame[n] for n in _PEOPLE if n in frame), None), list):
        return _named_people(listed)
    people = [_named_person(entry) for entry in (frame if isinstance(frame, list) else [frame])]
    known = [person for person in people if person is not None]
    return known if len(known) == len(people) else None


def _named_person(entry: Any) -> _Named | None:
    if not isinstance(entry, dict) or not entry:
        return None
    if all(map(_is_point, entry.values())):
        return entry
    inner = next((entry[name] for name in _PERSON if isinstance(entry.get(name), dict)), None)
    return inner if inner is not None and all(map(_is_point, inner.values())) else None


def _is_point(value: Any) -> bool:
    if isinstance(value, list):
        return 2 <= len(value) <= 4 and all(isinstance(v, (int, float)) or v is None for v in value)
    return value is None or (isinstance(value, dict) and {"x", "y"} <= value.keys())


def _are_named_frames(frames: Iterable[Any]) -> bool:
    """Return whether the first frame with a person names its points."""
    for frame in frames:
        if people := _named_people(frame):
            return max(map(len, people)) >= _LEAST
        if people is None:
            return False
    return False


def _read_named_frames(frames: Mapping[int, Any], path: Path) -> CameraFrames:
    listed: dict[int, list[_Named]] = {}
    for number, frame in frames.items():
        people = _named_people(frame)
        if people is None:
            raise FileDamaged(f"Frame {number} does not name its points, but other frames do.", where=str(path))
        listed[number] = people
    names = tuple(dict.fromkeys(name for people in listed.values() for person in people for name in person))
    found = {n: [_named_array(person, names, str(path)) for person in people] for n, people in listed.items()}
    return CameraFrames.in_memory(found, path, names)


def _named_array(person: _Named, names: Sequence[str], where: str) -> np.ndarray:
    try:
        return np.array([_named_point(person.get(name)) for name in names], np.float64).reshape(-1, 3)
    except (TypeError, ValueError, OverflowError) as error:
        raise FileDamaged("A point in the file contains a value that is not a number.", where=where) from error


def _named_point(value: Any) -> tuple[Any, Any, Any]:
    if isinstance(value, dict):
        value = _object_point(value)
    if value is None or None in value:
        return 0.0, 0.0, 0.0
    return value[0], value[1], value[-1] if len(value) > 2 else 1.0


# Files that describe one image each.
LINES = (".jsonl", ".ndjson")  # Suffixes of files with one JSON document per line.
_PADDING = re.compile(r"del_(\d{1,18})_\d+")
"""Files without people, which Pose2Sim writes for missing frames of a time-shifted camera."""
_OWN_NAMES = "keypoints.json"
_FLAT = re.compile(r"(?P<camera>.*?[^\d_\-. ].*?)[_\-. ]+(\d{3,18})([_\-. ]*[A-Za-z]*)")
"""Camera and frame number in a file name when all cameras share a folder: ``cam01_000000000012_keypoints``."""
_FLAT_NUMBER_FIRST = re.compile(r"(\d{3,18})[_\-. ]+(?P<camera>.*?[^\d_\-. ].*)")
"""The same pattern with the frame number first, such as ``000012_cam01``."""


def _json_names(folder: Path) -> Iterable[str]:
    with os.scandir(folder) as entries:
        for entry in entries:
            lower = entry.name.lower()
            if lower.endswith(".json") and not lower.startswith(".") and lower != _OWN_NAMES:
                yield entry.name


def json_files(folder: Path) -> list[Path]:
    """List the JSON files in a folder, sorted by name, without hidden files and keypoint definitions."""
    return [folder / name for name in sorted(_json_names(folder))]


def has_json_files(folder: Path) -> bool:
    """Return whether ``json_files`` finds any files in a folder."""
    return any(True for _ in _json_names(folder))


def line_files(folder: Path) -> list[Path]:
    """List the JSON Lines files in a folder, sorted by name, without hidden files."""
    return sorted(p for p in folder.iterdir() if p.suffix.lower() in LINES and not p.name.startswith("."))


def cameras_of_flat_files(paths: Sequence[Path]) -> dict[str, list[Path]]:
    """Group the files in a folder by camera, or return {} if most names lack a camera or a frame number.

    The camera name comes before or after the frame number. Every camera needs at least two files. A single camera is
    accepted if its first file is an OpenPose document. Other files, such as a calibration, are skipped.
    """
    for pattern in (_FLAT, _FLAT_NUMBER_FIRST):
        cameras: dict[str, list[Path]] = {}
        for path in paths:
            if (found := pattern.fullmatch(path.stem)) is not None:
                cameras.setdefault(found["camera"].rstrip("_-. "), []).append(path)
        files = [path for of_camera in cameras.values() for path in of_camera]
        several = 2 * len(files) > len(paths) and min(map(len, cameras.values())) > 1
        if several and (len(cameras) > 1 or _shows_openpose(files[0])):
            return cameras
    return {}


def _shows_openpose(path: Path) -> bool:
    try:
        return _is_openpose(read_json(path))
    except FileDamaged:
        return False


def _read_frame(path: Path) -> Any:
    try:
        return read_json(path)
    except FileDamaged as error:
        hint = "Export this frame again or delete the file."
        raise FileDamaged(error.message, where=error.where, hint=hint) from error


def frames_in_files(paths: Sequence[Path], where: str, numbered: Sequence[str] = ()) -> CameraFrames:
    """Read one camera's detections from one JSON file per frame. File names contain the frame numbers.

    Args:
        paths: files of one camera.
        where: folder that contains them, for messages.
        numbered: names that contain the frame numbers. Default: the file names.
    """
    if not paths:
        raise FileDamaged("The folder contains no JSON files.", where=where, hint="Put one file per frame there.")
    stems = numbered or [path.stem for path in paths]
    padded = [_PADDING.fullmatch(stem) for stem in stems]
    padding = {int(found[1]): path for path, found in zip(paths, padded, strict=True) if found}
    filmed = [(stem, path) for stem, path, found in zip(stems, paths, padded, strict=True) if not found]
    numbers = frame_numbers([stem for stem, _ in filmed], where=where).tolist()
    by_number = dict(sorted((padding | dict(zip(numbers, (path for _, path in filmed), strict=True))).items()))
    files = tuple(by_number.values())
    if _are_named_frames(_read_frame(path) for path in dict.fromkeys(files[:: max(len(files) // 2, 1)])):
        return _read_named_frames({n: _read_frame(path) for n, path in by_number.items()}, Path(where))

    @lru_cache(maxsize=1)
    def document(row: int) -> Any:
        return _read_frame(files[row])

    return CameraFrames(
        np.array(list(by_number), np.int64),
        people=lambda row: people_in_picture(document(row), str(files[row])),
        where=lambda row: str(files[row]),
        hands=lambda row: _hands_in_picture(document(row), str(files[row])),
    )


# Documents that describe a whole take: AlphaPose formats, COCO annotations and results, and lists of frames.
_FRAME_LISTS = ("instance_info", "frames")
_FRAME_NUMBERS = ("frame_id", "frame", "frame_idx", "frame_index", "frame_number")
"""Keys of the list of frames in an object, and keys of a frame's number."""
_SUFFIX = re.compile(r"\.(jpe?g|png|bmp|tiff?|webp)$", re.IGNORECASE)


def documents_in(text: str, path: Path) -> Any:
    """Parse the JSON documents in a file: a single document, or one per line."""
    lines = [line for line in text.splitlines() if line.strip()] if text.lstrip()[:1] == "{" else []
    if len(lines) > 1 and all(line.lstrip()[:1] == "{" and line.rstrip()[-1:] == "}" for line in lines[:2]):
        return [parse_json(line, path) for line in lines]
    return parse_json(text, path)


def is_take(document: Any) -> bool:
    """Return whether a document describes a take in a known format, with one or more cameras."""
    return _is_by_camera(document) or _is_of_one_camera(document)


def _is_of_one_camera(document: Any) -> bool:
    return any(recognises(document) for recognises, _ in _DOCUMENTS)


def _is_by_camera(document: Any) -> bool:
    if not isinstance(document, dict) or len(document) < 2:
        return False
    lists = all(isinstance(frames, (list, dict)) for frames in document.values())
    return lists and all(map(_is_of_one_camera, document.values()))


def cameras_in_document(document: Any) -> tuple[str, ...]:
    """Return the camera names in a document of several cameras, or () for one camera.

    The names are the image folders, or the keys of the frame lists.
    """
    if _is_by_camera(document):
        return tuple(document)
    if _is_coco(document):
        pictures = [image.get("file_name") for image in document["images"] if isinstance(image, dict)]
    elif _is_list_of_people(document):
        pictures = [entry["image_id"] for entry in document]
    else:
        pictures = list(document) if _is_by_picture(document) else []
    folders = dict.fromkeys(_folder(str(picture)) for picture in pictures)
    return tuple(folders) if len(folders) > 1 and "" not in folders else ()


def frames_in_document(document: Any, path: Path, camera: str = "") -> CameraFrames | None:
    """Read one camera's frames from a document, or return None for an unknown format.

    Args:
        document: content of the file.
        path: file, for errors.
        camera: image folder of the camera if the document has several cameras. Empty reads all images.

    Raises:
        FileDamaged, KeypointCountMismatch: a frame or a person is damaged.
    """
    if camera and _is_by_camera(document):
        document = document[camera]
    read = next((read for recognises, read in _DOCUMENTS if recognises(document)), None)
    return None if read is None else read(document, path, camera)


def _frame_list(document: Any) -> list[Any] | None:
    """Return the list of frames: the document itself or MMPose's ``instance_info``. Return None for other documents."""
    listed = document
    if isinstance(document, dict):
        listed = next((document[name] for name in _FRAME_LISTS if isinstance(document.get(name), list)), None)
    if not isinstance(listed, list) or not listed or not isinstance(listed[0], dict):
        return None
    first = listed[0]
    openpose = all(map(_is_openpose, listed))
    numbered = openpose or any(name in first for name in _FRAME_NUMBERS) or "instances" in first
    return listed if numbered and (openpose or listed_people(first) is not None) else None


def _frames(document: Any, path: Path, _camera: str) -> CameraFrames:
    """Read a list of frames with people (MMPose, OpenPifPaf, MoveNet, MediaPipe)."""
    frames: dict[int, People] = {}
    names: tuple[str, ...] = ()
    for row, frame in enumerate(_frame_list(document) or ()):
        number = next((frame[n] for n in _FRAME_NUMBERS if n in frame), row) if isinstance(frame, dict) else None
        people = [] if (openpose := _is_openpose(frame)) else listed_people(frame)
        if isinstance(number, bool) or not isinstance(number, int) or people is None:
            raise FileDamaged(f"Entry {row} of the frame list has no frame number or no people.", where=str(path))
        if openpose:
            frames[number] = people_in_picture(frame, str(path))
            continue
        frames[number] = _kept(_person(entry, str(path)) for entry in people)
        names = names or next((found for entry in people if (found := _names_in(entry))), ())
    return CameraFrames.in_memory(frames, path, names)


def _numbered_frames(document: Any) -> dict[int, Any] | None:
    """Return a document's frames by number, or None if it is not a list or object of frames."""
    if isinstance(document, dict):
        listed = next((document[name] for name in _FRAME_LISTS if name in document), None)
        if listed is not None:
            return _numbered_frames(listed)
        named = [(_NUMBERED.fullmatch(name), frame) for name, frame in document.items()]
        frames = {int(found[1]): frame for found, frame in named if found}
        return frames if document and len(frames) == len(document) else None
    if not isinstance(document, list):
        return None
    rows: dict[int, Any] = {}
    for row, frame in enumerate(document):
        numbered = isinstance(frame, dict) and next((frame[n] for n in _FRAME_NUMBERS if n in frame), None)
        rows[numbered if isinstance(numbered, int) and not isinstance(numbered, bool) else row] = frame
    return rows if len(rows) == len(document) else None


def _is_named(document: Any) -> bool:
    frames = _numbered_frames(document)
    return frames is not None and _are_named_frames(frames.values())


def _is_coco(document: Any) -> bool:
    return isinstance(document, dict) and all(isinstance(document.get(k), list) for k in ("images", "annotations"))


def _coco(document: dict[str, Any], path: Path, camera: str) -> CameraFrames:
    """Read COCO annotations. Annotated points, with flag 1 (hidden) or 2 (visible), get confidence 1."""
    images = [image for image in document["images"] if isinstance(image, dict) and "id" in image]
    names = {str(image["id"]): str(image.get("file_name", image["id"])) for image in images}
    people: list[tuple[str, np.ndarray]] = []
    for entry in document["annotations"]:
        if not isinstance(entry, dict) or str(entry.get("image_id")) not in names:
            raise FileDamaged("An annotation refers to an image that is not in the file's list.", where=str(path))
        person = _triples(entry.get("keypoints"), "keypoints", str(path))
        if person[:, 2].max(initial=0) > 1:
            person[:, 2] = person[:, 2] > 0
        people.append((names[str(entry["image_id"])], person))
    categories = document.get("categories")
    first = categories[0] if isinstance(categories, list) and categories else None
    keypoints = first.get("keypoints") if isinstance(first, dict) else None
    keypoints = tuple(map(str, keypoints)) if isinstance(keypoints, list) else ()
    return _by_picture(list(names.values()), people, path, camera, keypoints)


def _is_list_of_people(document: Any) -> bool:
    if not isinstance(document, list) or not document:
        return False
    return all(isinstance(entry, dict) and {"image_id", "keypoints"} <= entry.keys() for entry in document)


def _list_of_people(document: list[dict[str, Any]], path: Path, camera: str) -> CameraFrames:
    people = [(str(e["image_id"]), _triples(e["keypoints"], "keypoints", str(path))) for e in document]
    return _by_picture(list(dict.fromkeys(name for name, _ in people)), people, path, camera)


def _is_by_picture(document: Any) -> bool:
    if not isinstance(document, dict) or not document or not all(isinstance(e, dict) for e in document.values()):
        return False
    return all(isinstance(e.get("people"), list) or isinstance(e.get("bodies"), list) for e in document.values())


def _pictures(document: dict[str, Any], path: Path, camera: str) -> CameraFrames:
    """Read AlphaPose's ``open`` and ``cmu`` formats: one object per image with ``people`` or ``bodies``."""
    people: list[tuple[str, np.ndarray]] = []
    for name, entry in document.items():
        if isinstance(entry.get("people"), list):
            people += [(name, person) for person in people_in_picture(entry, str(path))]
            continue
        for body in entry["bodies"]:
            joints = body.get("joints") if isinstance(body, dict) else None
            people.append((name, _triples(joints, "joints", str(path))))
    return _by_picture(list(document), people, path, camera)


def _by_picture(
    pictures: list[str], people: list[tuple[str, np.ndarray]], path: Path, camera: str, keypoints: tuple[str, ...] = ()
) -> CameraFrames:
    if camera:
        pictures = [name for name in pictures if _folder(name) == camera]
        people = [(name, person) for name, person in people if _folder(name) == camera]
    stems = [_SUFFIX.sub("", name) for name in pictures]
    numbers = dict(zip(pictures, frame_numbers(stems, where=str(path)).tolist(), strict=True))
    frames: dict[int, People] = {number: [] for number in numbers.values()}
    for name, person in people:
        if len(person):
            frames[numbers[name]].append(person)
    return CameraFrames.in_memory(frames, path, keypoints)


def _folder(picture: str) -> str:
    return PurePosixPath(picture.replace("\\", "/")).parent.name


_DOCUMENTS: tuple[tuple[Callable[[Any], bool], Callable[[Any, Path, str], CameraFrames]], ...] = (
    (_is_coco, _coco),
    (_is_list_of_people, _list_of_people),
    (lambda document: _frame_list(document) is not None, _frames),
    (_is_by_picture, _pictures),
    (_is_named, lambda document, path, _camera: _read_named_frames(_numbered_frames(document) or {}, path)),
)
"""Test function and reader for each document format, tried in this order."""
