"""JSON of a whole camera: AlphaPose in its forms, COCO's annotations and results, lists of frames of any program."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path, PurePosixPath
from typing import Any

from solver_backend.exchange.errors import FileDamaged
from solver_backend.exchange.json_file import parse_json
from solver_backend.io.detections.camera_frames import CameraFrames, People, triples
from solver_backend.io.detections.picture_documents import (
    are_named_frames,
    frame_number,
    instance,
    is_openpose,
    listed_people,
    names_in,
    people_in_picture,
    read_named_frames,
)
from solver_backend.io.recognition.frame_numbers import frame_numbers

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
