"""JSON of one picture: OpenPose, EasyMocap's annotations, MMPose's instances."""

from __future__ import annotations

from typing import Any

import numpy as np

from solver_backend.exchange.errors import FileDamaged, KeypointCountMismatch
from solver_backend.exchange.hand_points import NUM_HAND_POINTS, SIDES
from solver_backend.io.detections.camera_frames import Hands, People, points_with_scores, triples

_OPENPOSE = ("pose_keypoints_2d", "pose_keypoints")
"""Names of the body's list, of today's OpenPose and of version 1.0."""

_OPENPOSE_HANDS = (("hand_{}_keypoints_2d", "hand_{}_keypoints"), ("handl2d", "handr2d"))
"""Names of the hands' lists: of today's OpenPose and of version 1.0, by side, and of EasyMocap, left and right."""


def people_in_picture(document: Any, where: str) -> People:
    """Return everybody in a picture's document.

    Raises:
        FileDamaged: the document is of none of these programs, or a person in it is damaged.
        KeypointCountMismatch: a list of keypoints is not made of triples.
    """
    if isinstance(document, dict) and isinstance(document.get("people"), list):
        return _kept(_openpose_person(entry, where) for entry in document["people"])
    if isinstance(document, dict) and isinstance(document.get("annots"), list):
        return _kept(_easymocap_person(entry, where) for entry in document["annots"])
    if isinstance(document, list) and all(isinstance(entry, dict) and "keypoint_scores" in entry for entry in document):
        return _kept(instance(entry, where) for entry in document)
    raise FileDamaged(
        "The file lacks OpenPose's list 'people'.", where=where,
        hint="Also read: EasyMocap's 'annots' and MMPose's instances with 'keypoints' and 'keypoint_scores'.",
    )  # fmt: skip


def hands_in_picture(document: Any, where: str) -> Hands:
    """Return the hands of everybody in a picture's document, in the order of ``people_in_picture``.

    Raises:
        KeypointCountMismatch: a hand has another number of points than 21.
        FileDamaged: its list holds no numbers.
    """
    entries = document.get("people", document.get("annots", ())) if isinstance(document, dict) else ()
    return [_hands(entry, where) for entry in entries if isinstance(entry, dict) and _is_somebody(entry)]


def _is_somebody(entry: dict[str, Any]) -> bool:
    return any(entry.get(name) for name in (*_OPENPOSE, "keypoints"))


def _hands(entry: dict[str, Any], where: str) -> np.ndarray | None:
    by_side, easymocap = _OPENPOSE_HANDS
    named = [[name.format(side) for name in by_side] + [easymocap[s]] for s, side in enumerate(SIDES)]
    names = [next((name for name in names if entry.get(name)), "") for names in named]
    if not any(names):
        return None
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
    """Return (K, 3) of one of MMPose's instances.

    Raises:
        FileDamaged, KeypointCountMismatch: it is none.
    """
    if not isinstance(entry, dict):
        raise FileDamaged("An instance in the file is no object.", where=where)
    return points_with_scores(entry.get("keypoints"), entry.get("keypoint_scores"), where)


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
