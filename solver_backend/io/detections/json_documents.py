"""JSON of one picture: OpenPose, EasyMocap, MMPose's and Sapiens' instances, OpenPifPaf, points as objects."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from solver_backend.exchange.errors import FileDamaged, KeypointCountMismatch
from solver_backend.exchange.hand_points import NUM_HAND_POINTS, SIDES
from solver_backend.exchange.json_file import parse_json
from solver_backend.io.detections.camera_frames import (
    SCORES,
    CameraFrames,
    Hands,
    People,
    are_objects,
    names_of_objects,
    objects,
    points_with_scores,
    triples,
)
from solver_backend.io.files import LARGEST_TEXT, read_bytes
from solver_backend.io.recognition.frame_numbers import frame_numbers

_OPENPOSE = ("pose_keypoints_2d", "pose_keypoints")
"""Names of the body's list, of today's OpenPose and of version 1.0."""

_OPENPOSE_HANDS = (("hand_{}_keypoints_2d", "hand_{}_keypoints"), ("handl2d", "handr2d"))
"""Names of the hands' lists: of today's OpenPose and of version 1.0, by side, and of EasyMocap, left and right."""

_HAND_LISTS = tuple(
    (*(name.format(side) for name in _OPENPOSE_HANDS[0]), _OPENPOSE_HANDS[1][s]) for s, side in enumerate(SIDES)
)
"""Of each side, the names under which its list may stand."""
_ANY_HAND = tuple(name for names in _HAND_LISTS for name in names)
_LISTS = ("instances", "instance_info", "predictions", "poses", "persons", "people", "detections")
"""Names of the list of people where an object holds it."""
_POINTS = ("keypoints", "pose_keypoints_2d", "landmarks", "pose_landmarks", "poseLandmarks", "joints", "joints2d")
_POINTS += ("keypoints2d", "keypoints_2d", "kpts")
_SCORES = ("keypoint_scores", "keypoints_scores", "scores")
"""Names of a person's points and of the scores beside them."""
_TRIPLE = "x", "y", "score"
_BOXES = "bboxes", "labels"
"""What MMDetection writes of a picture."""


def people_in_picture(document: Any, where: str) -> People:
    """Return everybody in a picture's document.

    Raises:
        FileDamaged: the document is of none of these programs, or a person in it is damaged.
        KeypointCountMismatch: a list of keypoints is not made of triples.
    """
    if _is_empty(document):
        return []
    if isinstance(document, dict) and isinstance(document.get("people"), list) and not _are_objects(document["people"]):
        return _kept(_openpose_person(entry, where) for entry in document["people"])
    if isinstance(document, dict) and isinstance(document.get("annots"), list):
        return _kept(_easymocap_person(entry, where) for entry in document["annots"])
    if (people := listed_people(document)) is not None:
        return _kept(instance(entry, where) for entry in people)
    if isinstance(document, dict) and all(name in document for name in _BOXES):
        hint = "Run a pose estimator on the pictures, such as MMPose's inferencer with --pred-out-dir."
        what = "The file holds boxes of a detector, as MMDetection writes them, and no keypoints."
        raise FileDamaged(what, where=where, hint=hint)
    hint = "Also read: EasyMocap's 'annots', MMPose's instances with 'keypoints' and 'keypoint_scores', OpenPifPaf's "
    hint += "predictions, and points that are objects with x, y and score."
    raise FileDamaged("The file lacks OpenPose's list 'people'.", where=where, hint=hint)


def _is_empty(document: Any) -> bool:
    return document is None or (isinstance(document, dict) and document.get("people", ...) is None)


def _are_objects(people: list[Any]) -> bool:
    return bool(people) and all(
        isinstance(entry, dict) and not any(name in entry for name in _OPENPOSE) and _points_of(entry) is not None
        for entry in people
    )


def is_openpose(document: Any) -> bool:
    """Whether a document is OpenPose's of a picture: its people have OpenPose's lists, or are ``{}``."""
    people = document.get("people") if isinstance(document, dict) else None
    return isinstance(people, list) and all(
        isinstance(entry, dict) and (not entry or any(name in entry for name in _OPENPOSE)) for entry in people
    )


def listed_people(document: Any) -> list[Any] | None:
    """Return the list of people in a document whose people are all of a known form; None where it holds none.

    It is the document itself or a list in it (``instances`` of MMPose, ``predictions`` of OpenPifPaf, ``poses`` of
    MoveNet), or the document is one person (``landmarks`` of MediaPipe).
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


def hands_in_picture(document: Any, where: str) -> Hands:
    """Return the hands of everybody in a picture's document, in the order of ``people_in_picture``.

    Raises:
        KeypointCountMismatch: a hand has another number of points than 21.
        FileDamaged: its list holds no numbers.
    """
    entries = (document.get("people", document.get("annots")) or ()) if isinstance(document, dict) else ()
    return [_hands(entry, where) for entry in entries if isinstance(entry, dict) and _is_somebody(entry)]


def _is_somebody(entry: dict[str, Any]) -> bool:
    return any(entry.get(name) for name in (*_OPENPOSE, "keypoints"))


def _hands(entry: dict[str, Any], where: str) -> np.ndarray | None:
    if not any(map(entry.get, _ANY_HAND)):
        return None
    names = [next((name for name in names if entry.get(name)), "") for names in _HAND_LISTS]
    hands = np.zeros((len(SIDES), NUM_HAND_POINTS, 3))
    for s, name in enumerate(names):
        if not name:
            continue
        points = triples(entry[name], name, where)
        if len(points) != NUM_HAND_POINTS:
            what = f"'{name}' holds {len(points)} points; {NUM_HAND_POINTS} of a hand are expected."
            raise KeypointCountMismatch(what, where=where)
        hands[s] = points
    return hands


def instance(entry: Any, where: str) -> Any:
    """Return (K, 3) of a person: points with scores beside them, triples, or objects with x, y and score.

    Raises:
        FileDamaged, KeypointCountMismatch: it is none.
    """
    if not isinstance(entry, dict):
        raise FileDamaged("An instance in the file is not an object.", where=where)
    points = _points_of(entry)
    if isinstance(points, list) and not points:
        return np.zeros((0, 3))
    if are_objects(points):
        return objects(points, where)
    scores = next((entry[name] for name in _SCORES if name in entry), None)
    return triples(points, "keypoints", where) if scores is None else points_with_scores(points, scores, where)


def _several(document: dict[str, Any]) -> list[Any] | None:
    """Return the people of a document whose lists hold all of them: (P, K, 2) points and (P, K) scores."""
    people = _points_of(document)
    if not people or not all(isinstance(person, list) and person for person in people):
        return None
    if not all(isinstance(point, list) for point in people[0]):
        return None
    name = next((name for name in _SCORES[:-1] if name in document), None)
    scores = document[name] if name is not None else [[1.0] * len(person) for person in people]
    if not isinstance(scores, list) or len(scores) != len(people):
        return None
    if len(people[0][0]) == len(_TRIPLE) and name is None:
        return [{_POINTS[0]: person} for person in people]
    return [{_POINTS[0]: person, _SCORES[0]: of_each} for person, of_each in zip(people, scores, strict=True)]


def names_in(entry: dict[str, Any]) -> tuple[str, ...]:
    """Return the names of a person's points where they are objects that name themselves."""
    points = _points_of(entry)
    return names_of_objects(points) if are_objects(points) else ()


def _points_of(entry: dict[str, Any]) -> Any:
    """Return a person's points, None where the entry is no person: MMPose's boxes alone, or a list of another kind."""
    points = next((entry[name] for name in _POINTS if name in entry), None)
    return points if isinstance(points, list) else None


def _openpose_person(entry: Any, where: str) -> Any:
    """Return (K, 3); None for the ``{}`` that Pose2Sim writes where it matched nobody."""
    if entry == {}:
        return None
    if not isinstance(entry, dict):
        raise FileDamaged(f"A person in the file lacks '{_OPENPOSE[0]}'.", where=where)
    name = next((name for name in _OPENPOSE if name in entry), _OPENPOSE[0])
    return triples(entry.get(name), name, where)


def _easymocap_person(entry: Any, where: str) -> Any:
    return triples(entry.get("keypoints") if isinstance(entry, dict) else None, "keypoints", where)


def _kept(people: Any) -> People:
    return [person for person in people if person is not None and len(person)]


_LEAST = 5
"""Points that a person must have for its form to be recognised; a later one may have fewer."""
_PERSON, _PEOPLE = ("keypoints", "landmarks", "points", "joints", "pose"), ("people", "persons", "instances", "poses")
"""Names of a person's points where an object holds them, and of the list of people in a frame."""
_NUMBERED = re.compile(r"(?:.*\D)?(\d{1,18})(\.\w+)?")
"""A frame's name, such as ``12``, ``frame_000012`` or ``000012.jpg``."""

Person = Mapping[str, Any]
"""Points by name: lists of x, y and perhaps a score, objects with x and y, or null for what is unseen."""


def named_people(frame: Any) -> list[Person] | None:
    """Return the people of a frame whose points are an object by name; None where it holds nothing of that form."""
    if frame is None or frame in ({}, []):
        return []
    if isinstance(frame, list):
        people = [_person(entry) for entry in frame]
        return None if any(person is None for person in people) else [p for p in people if p is not None]
    if isinstance(frame, dict) and isinstance(listed := next((frame[n] for n in _PEOPLE if n in frame), None), list):
        return named_people(listed)
    person = _person(frame)
    return None if person is None else [person]


def are_named_frames(frames: Sequence[Any]) -> bool:
    """Whether frames are of that form: the first that holds anybody."""
    for frame in frames:
        if people := named_people(frame):
            return max(map(len, people)) >= _LEAST
        if people is None:
            return False
    return False


def frame_number(name: str) -> int | None:
    """Return the number in a frame's name, None where it is no such name."""
    found = _NUMBERED.fullmatch(name)
    return int(found[1]) if found else None


def read_named_frames(frames: Mapping[int, Any], where: str) -> tuple[dict[int, People], tuple[str, ...]]:
    """Return people (K, 3) of numbered frames, and the names of the K points: those of all frames together.

    Raises:
        FileDamaged: a frame is of another form, or a coordinate is no number.
    """
    listed: dict[int, list[Person]] = {}
    for number, frame in frames.items():
        people = named_people(frame)
        if people is None:
            raise FileDamaged(f"Frame {number} holds no points by name, as others do.", where=where)
        listed[number] = people
    names = tuple(dict.fromkeys(name for people in listed.values() for person in people for name in person))
    return {n: [_array(person, names, where) for person in people] for n, people in listed.items()}, names


def _person(entry: Any) -> Person | None:
    if not isinstance(entry, dict) or not entry:
        return None
    if all(_is_point(value) for value in entry.values()):
        return entry
    inner = next((entry[name] for name in _PERSON if isinstance(entry.get(name), dict)), None)
    if inner is None or not all(_is_point(value) for value in inner.values()):
        return None
    return inner


def _is_point(value: Any) -> bool:
    if isinstance(value, list):
        return 2 <= len(value) <= 4 and all(isinstance(v, (int, float)) or v is None for v in value)
    return value is None or (isinstance(value, dict) and {"x", "y"} <= value.keys())


def _array(person: Person, names: Sequence[str], where: str) -> np.ndarray:
    try:
        return np.array([_point(person.get(name)) for name in names], np.float64).reshape(-1, 3)
    except (TypeError, ValueError, OverflowError) as error:
        raise FileDamaged("A point in the file holds something that is not a number.", where=where) from error


def _point(value: Any) -> tuple[Any, Any, Any]:
    if isinstance(value, dict):
        value = [value["x"], value["y"], next((value[name] for name in SCORES if name in value), 1.0)]
    if value is None or None in value:
        return 0.0, 0.0, 0.0
    return value[0], value[1], value[-1] if len(value) > 2 else 1.0


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
        np.array(list(by_number), np.int64),
        people=lambda row: people_in_picture(document(row), str(files[row])),
        where=lambda row: str(files[row]),
        hands=lambda row: hands_in_picture(document(row), str(files[row])),
    )


def read_document(path: Path) -> Any:
    """Return what one picture's file holds.

    Raises:
        FileDamaged: the file is truncated or is not JSON.
    """
    data = read_bytes(path, LARGEST_TEXT)
    try:
        return json.loads(data)
    except (ValueError, RecursionError) as error:
        hint = "Export this frame again or delete the file."
        raise FileDamaged(f"The file is truncated or is not JSON ({error}).", where=str(path), hint=hint) from error


_COCO_VISIBLE = 1.0
"""Confidence of an annotated COCO keypoint, 1 (hidden) or 2 (visible): people clicked it."""

_FRAME_LISTS = ("instance_info", "frames")
_FRAME_NUMBERS = ("frame_id", "frame", "frame_idx", "frame_index", "frame_number")
"""Names of the list of frames where an object holds it, and of a frame's number."""


def documents_in(text: str, path: Path) -> Any:
    """Return what a file holds: one JSON document, or the list of those on its lines (OpenPifPaf's videos).

    Raises:
        FileDamaged: it is neither.
    """
    lines = [line for line in text.splitlines() if line.strip()] if text.lstrip()[:1] == "{" else []
    if len(lines) > 1 and all(line.lstrip()[:1] == "{" and line.rstrip()[-1:] == "}" for line in lines[:2]):
        return [parse_json(line, path) for line in lines]
    return parse_json(text, path)


def is_take(document: Any) -> bool:
    """Whether a document is of a known form, of one camera or of several."""
    return _is_by_camera(document) or any(recognises(document) for recognises, _ in _DOCUMENTS)


def cameras_in_document(document: Any) -> tuple[str, ...]:
    """Return the cameras of a document of several, () where it is of one.

    They are the folders of its pictures' names, or its own names of lists of frames.
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
    """Return the frames of one camera that a document holds; None if it is of no program that writes whole takes.

    Args:
        document: what the file holds.
        camera: folder of the pictures to read, of a document of several cameras; empty for all.

    Raises:
        FileDamaged, KeypointCountMismatch: it is, and a frame or a person in it is damaged.
    """
    if camera and _is_by_camera(document):
        document = document[camera]
    read = next((read for recognises, read in _DOCUMENTS if recognises(document)), None)
    return None if read is None else read(document, path, camera)


def _frame_list(document: Any) -> list[Any] | None:
    """Return the list of frames in a document: itself, or MMPose's ``instance_info`` where that lists frames."""
    listed = document
    if isinstance(document, dict):
        listed = next((document[name] for name in _FRAME_LISTS if isinstance(document.get(name), list)), None)
    if not isinstance(listed, list) or not listed or not isinstance(listed[0], dict):
        return None
    first = listed[0]
    openpose = all(map(is_openpose, listed))
    numbered = openpose or any(name in first for name in _FRAME_NUMBERS) or "instances" in first
    return listed if numbered and (openpose or listed_people(first) is not None) else None


def _is_frame_list(document: Any) -> bool:
    return _frame_list(document) is not None


def _frames(document: Any, path: Path, _camera: str) -> CameraFrames:
    """Read a list of frames, each with its number and its people (MMPose, OpenPifPaf, MoveNet, MediaPipe)."""
    frames: dict[int, People] = {}
    names: tuple[str, ...] = ()
    for row, frame in enumerate(_frame_list(document) or ()):
        number = next((frame[n] for n in _FRAME_NUMBERS if n in frame), row) if isinstance(frame, dict) else None
        openpose = is_openpose(frame)
        people = [] if openpose else listed_people(frame)
        if isinstance(number, bool) or not isinstance(number, int) or people is None:
            raise FileDamaged(f"Entry {row} of the list of frames lacks its number or its people.", where=str(path))
        if openpose:
            frames[number] = people_in_picture(frame, str(path))
            continue
        frames[number] = [person for entry in people if len(person := instance(entry, str(path)))]
        names = names or next((found for entry in people if (found := names_in(entry))), ())
    return CameraFrames.in_memory(frames, path, names)


def _numbered_frames(document: Any) -> dict[int, Any] | None:
    if isinstance(document, dict):
        listed = next((document[name] for name in _FRAME_LISTS if name in document), None)
        if listed is not None:
            return _numbered_frames(listed)
        numbers = [frame_number(name) for name in document]
        frames = {n: frame for n, frame in zip(numbers, document.values(), strict=True) if n is not None}
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
    return frames is not None and are_named_frames(list(frames.values()))


def _named(document: Any, path: Path, _camera: str) -> CameraFrames:
    frames, names = read_named_frames(_numbered_frames(document) or {}, str(path))
    return CameraFrames.in_memory(frames, path, names)


def _is_by_camera(document: Any) -> bool:
    if not isinstance(document, dict) or len(document) < 2:
        return False
    lists = all(isinstance(frames, (list, dict)) for frames in document.values())
    return lists and all(any(recognises(frames) for recognises, _ in _DOCUMENTS) for frames in document.values())


def _is_coco(document: Any) -> bool:
    return isinstance(document, dict) and all(isinstance(document.get(k), list) for k in ("images", "annotations"))


def _coco(document: dict[str, Any], path: Path, camera: str) -> CameraFrames:
    images = [image for image in document["images"] if isinstance(image, dict) and "id" in image]
    names = {str(image["id"]): str(image.get("file_name", image["id"])) for image in images}
    people: list[tuple[str, Any]] = []
    for entry in document["annotations"]:
        if not isinstance(entry, dict) or str(entry.get("image_id")) not in names:
            raise FileDamaged("An annotation names a picture that the file does not list.", where=str(path))
        person = triples(entry.get("keypoints"), "keypoints", str(path))
        person[:, 2] = _COCO_VISIBLE * (person[:, 2] > 0) if person[:, 2].max(initial=0) > 1 else person[:, 2]
        people.append((names[str(entry["image_id"])], person))
    return _by_picture(list(names.values()), people, path, camera, _coco_keypoints(document))


def _coco_keypoints(document: dict[str, Any]) -> tuple[str, ...]:
    categories = document.get("categories")
    first = categories[0] if isinstance(categories, list) and categories else None
    names = first.get("keypoints") if isinstance(first, dict) else None
    return tuple(map(str, names)) if isinstance(names, list) else ()


def _is_list_of_people(document: Any) -> bool:
    if not isinstance(document, list) or not document:
        return False
    return all(isinstance(entry, dict) and {"image_id", "keypoints"} <= entry.keys() for entry in document)


def _list_of_people(document: list[dict[str, Any]], path: Path, camera: str) -> CameraFrames:
    people = [(str(e["image_id"]), triples(e["keypoints"], "keypoints", str(path))) for e in document]
    return _by_picture(list(dict.fromkeys(name for name, _ in people)), people, path, camera)


def _is_by_picture(document: Any) -> bool:
    if not isinstance(document, dict) or not document or not all(isinstance(e, dict) for e in document.values()):
        return False
    return all(isinstance(e.get("people"), list) or isinstance(e.get("bodies"), list) for e in document.values())


def _pictures(document: dict[str, Any], path: Path, camera: str) -> CameraFrames:
    """Read AlphaPose's ``open`` and ``cmu`` forms: an object a picture, with ``people`` or ``bodies``."""
    people: list[tuple[str, Any]] = []
    for name, entry in document.items():
        if isinstance(entry.get("people"), list):
            people += [(name, person) for person in people_in_picture(entry, str(path))]
            continue
        for body in entry["bodies"]:
            joints = body.get("joints") if isinstance(body, dict) else None
            people.append((name, triples(joints, "joints", str(path))))
    return _by_picture(list(document), people, path, camera)


def _by_picture(
    pictures: list[str], people: list[tuple[str, Any]], path: Path, camera: str, keypoints: tuple[str, ...] = ()
) -> CameraFrames:
    if camera:
        pictures = [name for name in pictures if _folder(name) == camera]
        people = [(name, person) for name, person in people if _folder(name) == camera]
    stems = [re.sub(r"\.(jpe?g|png|bmp|tiff?|webp)$", "", name, flags=re.IGNORECASE) for name in pictures]
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
    (_is_frame_list, _frames),
    (_is_by_picture, _pictures),
    (_is_named, _named),
)
"""Asked in this order: whether a document is of this kind, and how it is read."""
