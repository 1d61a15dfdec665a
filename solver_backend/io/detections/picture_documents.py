"""JSON of one picture: OpenPose, EasyMocap, MMPose's and Sapiens' instances, OpenPifPaf, points as objects."""

from __future__ import annotations

from typing import Any

import numpy as np

from solver_backend.exchange.errors import FileDamaged, KeypointCountMismatch
from solver_backend.exchange.hand_points import NUM_HAND_POINTS, SIDES
from solver_backend.io.detections.camera_frames import (
    Hands,
    People,
    are_objects,
    names_of_objects,
    objects,
    points_with_scores,
    triples,
)

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
_POINTS = (
    "keypoints", "pose_keypoints_2d", "landmarks", "pose_landmarks", "poseLandmarks", "joints", "joints2d",
    "keypoints2d", "keypoints_2d", "kpts",
)  # fmt: skip
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
        raise FileDamaged(
            "The file holds boxes of a detector, as MMDetection writes them, and no keypoints.", where=where,
            hint="Run a pose estimator on the pictures, such as MMPose's inferencer with --pred-out-dir.",
        )  # fmt: skip
    raise FileDamaged(
        "The file lacks OpenPose's list 'people'.", where=where,
        hint="Also read: EasyMocap's 'annots', MMPose's instances with 'keypoints' and 'keypoint_scores', OpenPifPaf's "
        "predictions, and points that are objects with x, y and score.",
    )  # fmt: skip


def _is_empty(document: Any) -> bool:
    """Whether a document is what programs write of a picture without people: null, or an object whose list is null."""
    return document is None or (isinstance(document, dict) and document.get("people", ...) is None)


def _are_objects(people: list[Any]) -> bool:
    """Whether people are of another form than OpenPose's: all have points of another name."""
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
            raise KeypointCountMismatch(
                f"'{name}' holds {len(points)} points; {NUM_HAND_POINTS} of a hand are expected.", where=where
            )
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
