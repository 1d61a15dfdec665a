"""Points of hands among keypoints that files name themselves: ``left_index_tip``, ``L_thumb_mcp``, ``ring3_R``."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from solver_backend.exchange.hand_points import HAND_POINTS, NUM_HAND_POINTS, SIDES
from solver_backend.io.detections.camera_frames import CameraFrames, Hands, People
from solver_backend.io.detections.named_keypoints import plain_name
from solver_backend.types import UNSEEN_POINT

LEAST_POINTS = 6
"""Points of one hand that make it one: its palm and two fingers, perhaps."""
_SIDES = {"l": 0, "left": 0, "lt": 0, "r": 1, "right": 1, "rt": 1}
_FINGERS = {
    "thumb": 0, "index": 1, "forefinger": 1, "fore": 1, "pointer": 1, "middle": 2, "mid": 2, "ring": 3, "pinky": 4,
    "little": 4, "pinkie": 4,
}  # fmt: skip
_OF_THUMB = {"cmc": 0, "mcp": 1, "ip": 2, "dip": 2, "tip": 3, "end": 3}
_OF_FINGER = {"mcp": 0, "knuckle": 0, "base": 0, "pip": 1, "dip": 2, "tip": 3, "end": 3}
"""Place along a finger by word; numbers count from 1, the first being the thumb's root and the others' knuckles."""
_ROOTS = ({"hand", "root"}, {"hand", "wrist"})
"""Words of the point at the wrist that belongs to a hand."""
_NOISE = {"finger", "hand", "joint", "keypoint", "kp"}


def hand_point(name: str) -> tuple[int, int] | None:
    """Return the side, 0 left and 1 right, and the point in ``HAND_POINTS`` of a name; None where it is no hand's.

    A finger without a place, such as the ``left_index`` of bodies, is none.
    """
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Za-z])(?=\d)|(?<=^[LR])(?=[A-Z][a-z])", "_", name.strip())
    words = [word for word in re.split(r"[^a-z0-9]+", spaced.lower()) if word]
    sides = {_SIDES[word] for word in words if word in _SIDES}
    rest = {word for word in words if word not in _SIDES}
    if len(sides) != 1:
        return None
    side = sides.pop()
    if rest in _ROOTS:
        return side, 0
    fingers = {_FINGERS[word] for word in rest if word in _FINGERS}
    places = [word for word in rest if word not in _FINGERS and word not in _NOISE]
    if len(fingers) != 1 or len(places) != 1:
        return None
    finger, place = fingers.pop(), places[0]
    known = _OF_FINGER if finger else _OF_THUMB
    along = int(place) - 1 if place.isdecimal() and len(place) == 1 else known.get(place, -1)
    return (side, 1 + 4 * finger + along) if 0 <= along < 4 else None


HAND_LANDMARKS = tuple(f"{side}_{point}" for side in SIDES for point in HAND_POINTS[1:])
"""Names of the points of hands beside a body's wrists."""


def with_named_hands(frames: CameraFrames) -> CameraFrames:
    """Return a camera's frames with hands where its files name their points, and the other keypoints.

    A hand without a wrist of its own takes the body's.
    """
    names = frames.keypoints
    found: dict[tuple[int, int], int] = {}
    for column, name in enumerate(names):
        if (point := hand_point(name)) is not None:
            found.setdefault(point, column)
    counts = [sum(side == own for side, _ in found) for own in range(len(SIDES))]
    found = {point: column for point, column in found.items() if counts[point[0]] >= LEAST_POINTS}
    if not found:
        return frames
    hand_columns = {column for column in range(len(names)) if hand_point(names[column]) in found}
    kept = [column for column in range(len(names)) if column not in hand_columns]
    index = np.full((len(SIDES), NUM_HAND_POINTS), -1)
    for (side, point), column in found.items():
        index[side, point] = column
    for side, name in enumerate(SIDES):
        wrist = _wrist(names, name)
        if index[side, 0] < 0 and (index[side] >= 0).any():
            index[side, 0] = wrist

    def people(row: int) -> People:
        return [person[kept] if len(person) == len(names) else person for person in frames.people(row)]

    def hands(row: int) -> Hands:
        return [_hands(person, index) if len(person) == len(names) else None for person in frames.people(row)]

    return replace(frames, people=people, hands=hands, keypoints=tuple(names[column] for column in kept))


def _wrist(names: Sequence[str], side: str) -> int:
    """Return the column of a body's wrist, -1 for none."""
    return next((column for column, name in enumerate(names) if plain_name(name) == f"{side}_wrist"), -1)


def _hands(person: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Return (2, 21, 3) of a person's (K, 3) points; what the files do not name is unseen."""
    return np.concatenate([person, [UNSEEN_POINT]])[index]
