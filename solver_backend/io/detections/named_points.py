"""Points as objects by name, as people's own scripts write them: ``{"left_wrist": [x, y, c], ...}``."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from solver_backend.exchange.errors import FileDamaged
from solver_backend.io.detections.camera_frames import SCORES, People

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
    """Return x, y and score; the last of four numbers is the score, as z stands before it."""
    if isinstance(value, dict):
        value = [value["x"], value["y"], next((value[name] for name in SCORES if name in value), 1.0)]
    if value is None or None in value:
        return 0.0, 0.0, 0.0
    return value[0], value[1], value[-1] if len(value) > 2 else 1.0
