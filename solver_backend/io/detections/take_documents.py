"""JSON of a whole camera: AlphaPose in its three forms, MMPose's inferencer, COCO's annotations and results."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from solver_backend.exchange.errors import FileDamaged
from solver_backend.io.detections.camera_frames import CameraFrames, People, triples
from solver_backend.io.detections.picture_documents import instance, people_in_picture
from solver_backend.io.recognition.frame_numbers import frame_numbers

_COCO_VISIBLE = 1.0
"""Confidence of an annotated COCO keypoint, 1 (hidden) or 2 (visible): people clicked it."""


def frames_in_document(document: Any, path: Path) -> CameraFrames | None:
    """Return the frames of one camera that a document holds; None if it is of no program that writes whole takes.

    Raises:
        FileDamaged, KeypointCountMismatch: it is, and a frame or a person in it is damaged.
    """
    read = next((read for recognises, read in _DOCUMENTS if recognises(document)), None)
    return None if read is None else read(document, path)


def _is_mmpose(document: Any) -> bool:
    return isinstance(document, dict) and isinstance(document.get("instance_info"), list)


def _mmpose(document: dict[str, Any], path: Path) -> CameraFrames:
    """Read MMPose's inferencer: ``instance_info`` lists frames, counted from 1, with their instances."""
    frames: dict[int, People] = {}
    for row, frame in enumerate(document["instance_info"]):
        number, found = (frame.get("frame_id", row + 1), frame.get("instances")) if isinstance(frame, dict) else (0, 0)
        if not isinstance(number, int) or not isinstance(found, list):
            raise FileDamaged(f"Entry {row} of 'instance_info' lacks 'frame_id' or 'instances'.", where=str(path))
        frames[number] = [instance(entry, str(path)) for entry in found]
    return CameraFrames.in_memory(frames, path)


def _is_coco(document: Any) -> bool:
    return isinstance(document, dict) and all(isinstance(document.get(k), list) for k in ("images", "annotations"))


def _coco(document: dict[str, Any], path: Path) -> CameraFrames:
    """Read COCO's annotations: pictures with id and file name, people with keypoints and a visibility of 0 to 2."""
    images = [image for image in document["images"] if isinstance(image, dict) and "id" in image]
    names = {str(image["id"]): str(image.get("file_name", image["id"])) for image in images}
    people: list[tuple[str, Any]] = []
    for entry in document["annotations"]:
        if not isinstance(entry, dict) or str(entry.get("image_id")) not in names:
            raise FileDamaged("An annotation names a picture that the file does not list.", where=str(path))
        person = triples(entry.get("keypoints"), "keypoints", str(path))
        person[:, 2] = _COCO_VISIBLE * (person[:, 2] > 0) if person[:, 2].max(initial=0) > 1 else person[:, 2]
        people.append((names[str(entry["image_id"])], person))
    return _by_picture(list(names.values()), people, path, _coco_keypoints(document))


def _coco_keypoints(document: dict[str, Any]) -> tuple[str, ...]:
    categories = document.get("categories")
    first = categories[0] if isinstance(categories, list) and categories else None
    names = first.get("keypoints") if isinstance(first, dict) else None
    return tuple(map(str, names)) if isinstance(names, list) else ()


def _is_list_of_people(document: Any) -> bool:
    return isinstance(document, list) and bool(document) and all(
        isinstance(entry, dict) and {"image_id", "keypoints"} <= entry.keys() for entry in document
    )  # fmt: skip


def _list_of_people(document: list[dict[str, Any]], path: Path) -> CameraFrames:
    """Read AlphaPose's and COCO's results: a list of people, each with the picture it was found in."""
    people = [(str(e["image_id"]), triples(e["keypoints"], "keypoints", str(path))) for e in document]
    return _by_picture(list(dict.fromkeys(name for name, _ in people)), people, path)


def _is_by_picture(document: Any) -> bool:
    return isinstance(document, dict) and bool(document) and all(
        isinstance(entry, dict) and (isinstance(entry.get("people"), list) or isinstance(entry.get("bodies"), list))
        for entry in document.values()
    )  # fmt: skip


def _pictures(document: dict[str, Any], path: Path) -> CameraFrames:
    """Read AlphaPose's ``open`` and ``cmu`` forms: an object a picture, with ``people`` or ``bodies``."""
    people: list[tuple[str, Any]] = []
    for name, entry in document.items():
        if isinstance(entry.get("people"), list):
            people += [(name, person) for person in people_in_picture(entry, str(path))]
            continue
        for body in entry["bodies"]:
            joints = body.get("joints") if isinstance(body, dict) else None
            people.append((name, triples(joints, "joints", str(path))))
    return _by_picture(list(document), people, path)


def _by_picture(
    pictures: list[str], people: list[tuple[str, Any]], path: Path, keypoints: tuple[str, ...] = ()
) -> CameraFrames:
    """Return frames numbered as the names of their pictures are."""
    stems = [re.sub(r"\.(jpe?g|png|bmp|tiff?|webp)$", "", name, flags=re.IGNORECASE) for name in pictures]
    numbers = dict(zip(pictures, frame_numbers(stems, where=str(path)).tolist(), strict=True))
    frames: dict[int, People] = {number: [] for number in numbers.values()}
    for name, person in people:
        if len(person):
            frames[numbers[name]].append(person)
    return CameraFrames.in_memory(frames, path, keypoints)


_DOCUMENTS: tuple[tuple[Callable[[Any], bool], Callable[[Any, Path], CameraFrames]], ...] = (
    (_is_mmpose, _mmpose), (_is_coco, _coco), (_is_list_of_people, _list_of_people), (_is_by_picture, _pictures),
)  # fmt: skip
"""Asked in this order: whether a document is of this kind, and how it is read."""
