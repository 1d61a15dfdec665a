"""Keypoints that files name themselves, in the order of the joint set that has most of them."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.exchange.errors import FileDamaged, KeypointCountMismatch
from solver_backend.exchange.hand_points import HAND_POINTS, NUM_HAND_POINTS, SIDES
from solver_backend.io.detections.camera_frames import CameraFrames, Hands, People
from solver_backend.io.files import read_json
from solver_backend.types import BONES, UNSEEN_POINT, JointSet, OwnPoint

LEAST_KNOWN = 8
"""Keypoints of a body that must be among the names: fewer do not hold a pose."""
_SIDES = {"l": "left", "left": "left", "lt": "left", "r": "right", "right": "right", "rt": "right"}
_PARTS = {"foot": "ankle", "hand": "wrist", "bigtoe": "big_toe", "smalltoe": "small_toe", "littletoe": "small_toe"}
_PARTS |= {"toe": "big_toe", **dict.fromkeys(("pelvis", "midhip", "hipcenter", "hipcentre"), "mid_hip")}
_PARTS |= dict.fromkeys(("headtop", "topofhead", "crown", "head"), "head_top")
"""Other words for the parts of joint sets, without separators."""
_WHOLE = {"neck", "nose", "mid_hip", "head_top", "upper_neck", "thorax", "spine"}


@dataclass(frozen=True)
class NamedKeypoints:
    """Which columns of a file are which keypoints of a joint set."""

    joint_set: JointSet
    """The set that has most of the names."""
    columns: tuple[int, ...]
    """(K,) column of each of its keypoints, -1 where the file has none."""
    unknown: tuple[str, ...]
    """Names that the set lacks."""
    own: tuple[int, ...] = ()
    """(N,) column of each point of the user's own, -1 where the file has none."""

    @property
    def found(self) -> frozenset[str]:
        """Return the set's keypoints that the file has."""
        return frozenset(n for n, c in zip(self.joint_set.keypoints, self.columns, strict=True) if c >= 0)

    def ordered(self, person: np.ndarray) -> np.ndarray:
        """Return (K + N, 3) in the set's order, own points last; what the file lacks is NaN with confidence 0."""
        padded = np.concatenate([person, [[np.nan, np.nan, 0.0]]])
        return padded[[*self.columns, *self.own]]


def match_cameras(
    names: Sequence[tuple[str, ...]], given: JointSet | None = None, own: Sequence[str] = (), *, where: str = ""
) -> list[NamedKeypoints]:
    """Return how each camera's names map to the joint set that has most of all names; [] where no file names any.

    Args:
        names: of C cameras, as their files write them; cameras may have different keypoints.
        given, where: see ``match_keypoints``.
        own: names of points that are on bones and no keypoints of a set.

    Raises:
        KeypointCountMismatch: only some cameras' files name theirs, or see ``match_keypoints``.
    """
    if not any(names):
        return []
    if not all(names):
        hint = "Export all cameras in one format."
        raise KeypointCountMismatch("Only some of the cameras' files name their keypoints.", where=where, hint=hint)
    everywhere = dict.fromkeys(n for camera in names for n in camera if n not in own)
    joint_set = match_keypoints(tuple(everywhere), given, where=where).joint_set
    return [_in_set(camera, joint_set, own) for camera in names]


def match_keypoints(names: tuple[str, ...], given: JointSet | None = None, *, where: str = "") -> NamedKeypoints:
    """Return how a file's names map to a joint set.

    Args:
        names: as the file writes them: ``LeftShoulder``, ``l_shoulder``, ``shoulder_R`` and ``left_shoulder`` are one.
        given: the set that the user wants; None takes the one that has most of the names.

    Raises:
        KeypointCountMismatch: fewer than ``LEAST_KNOWN`` names are known.
    """
    plain = [plain_name(name) for name in names]
    # Of sets with the same body the one without hands: only a body's points are named here.
    whole = (s for s in JointSet if s is not JointSet.SMPL_24 and s.num_keypoints in s.num_written)
    sets = (given,) if given is not None else tuple(whole)
    known = {s: len(set(s.keypoints) & set(plain)) for s in sets}
    best = max(sets, key=lambda s: (known[s], -s.num_keypoints))
    if known[best] < LEAST_KNOWN:
        strange = next((name for name, p in zip(names, plain, strict=True) if p not in best.keypoints), names[0])
        what = f"Of the {len(names)} named keypoints only {known[best]} are known: {', '.join(names[:12])}."
        hint = (
            f'such as {{"landmarks": {{"{strange}": "left_knee"}}}}. Landmarks: {", ".join(JointSet.COCO_17.keypoints)}'
        )
        hint = f"Name them in a file keypoints.json beside the recording, {hint}, ..."
        raise KeypointCountMismatch(what, where=where, hint=hint)
    return _in_set(names, best)


def _in_set(names: Sequence[str], joint_set: JointSet, own: Sequence[str] = ()) -> NamedKeypoints:
    plain = ["" if name in own else plain_name(name) for name in names]
    columns = tuple(plain.index(name) if name in plain else -1 for name in joint_set.keypoints)
    unknown = tuple(n for n, p in zip(names, plain, strict=True) if p not in joint_set.keypoints and n not in own)
    return NamedKeypoints(joint_set, columns, unknown, tuple(names.index(n) if n in names else -1 for n in own))


def plain_name(name: str) -> str:
    """Return a keypoint's name as joint sets write it, such as ``left_elbow``; unknown names in lower case."""
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])|(?<=^[LR])(?=[A-Z][a-z])", "_", name.strip())
    words = [word for word in re.split(r"[^a-z]+", spaced.lower()) if word]
    sides = [_SIDES[word] for word in words if word in _SIDES]
    rest = "".join(word for word in words if word not in _SIDES)
    if not sides and rest[:1] in "lr" and _part(rest[1:]) in _SIDED and _part(rest) not in _SIDED:
        sides, rest = [_SIDES[rest[0]]], rest[1:]
    part = _part(rest)
    return f"{sides[0]}_{part}" if len(sides) == 1 and part in _SIDED else part


def _part(word: str) -> str:
    part = _PARTS.get(word, word)
    return next((known for known in (*_SIDED, *_WHOLE) if known.replace("_", "") == part), part)


_SIDED = tuple(
    dict.fromkeys(name.removeprefix("left_") for s in JointSet for name in s.keypoints if name.startswith("left_"))
)
"""Parts that a body has on both sides."""


LEAST_POINTS = 6
"""Points of one hand that make it one: its palm and two fingers, perhaps."""
_SIDE_OF_WORD = {"l": 0, "left": 0, "lt": 0, "r": 1, "right": 1, "rt": 1}
_WORDS = ("thumb", "index forefinger fore pointer", "middle mid", "ring", "pinky little pinkie")
_FINGERS = {word: finger for finger, words in enumerate(_WORDS) for word in words.split()}
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
    sides = {_SIDE_OF_WORD[word] for word in words if word in _SIDE_OF_WORD}
    rest = {word for word in words if word not in _SIDE_OF_WORD}
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
    return next((column for column, name in enumerate(names) if plain_name(name) == f"{side}_wrist"), -1)


def _hands(person: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Return (2, 21, 3) of a person's (K, 3) points; what the files do not name is unseen."""
    return np.concatenate([person, [UNSEEN_POINT]])[index]


FILE = "keypoints.json"


@dataclass(frozen=True)
class OwnKeypoints:
    """What columns of detections are."""

    landmarks: Mapping[str, str | None]
    """Landmark of each own name, None for a point that is left out; other names are matched as usual."""
    order: tuple[str, ...] = ()
    """Names of the columns, where the files name none."""
    where: str = ""
    """The file, for errors."""
    points: tuple[OwnPoint, ...] = ()
    """Those that are no landmark, but at a constant place on a bone."""

    def apply(self, frames: CameraFrames) -> CameraFrames:
        """Return a camera's frames with landmarks for own points; several points that mean one become their mean.

        Raises:
            KeypointCountMismatch: a person has another number of points than there are names; with the first frame.
        """
        names = frames.keypoints or self.order
        if not names:
            return frames
        columns: dict[str, list[int]] = {}
        for column, name in enumerate(names):
            meant = self.landmarks.get(name, name)
            if meant is not None:
                columns.setdefault(meant, []).append(column)

        def people(row: int) -> People:
            found = frames.people(row)
            for person in found:
                if len(person) != len(names):
                    hint = "List every column's name under 'order'."
                    what = f"A person has {len(person)} keypoints; {self.where} names {len(names)}."
                    raise KeypointCountMismatch(what, where=frames.where(row), hint=hint)
            return [_means(person, list(columns.values())) for person in found]

        return replace(frames, people=people, keypoints=tuple(columns))


def find_own_keypoints(levels: Sequence[Path]) -> OwnKeypoints | None:
    """Return the nearest ``keypoints.json``, None where there is none.

    Raises:
        FileDamaged: it is no JSON, or names a landmark or a bone that no body has.
    """
    path = next((level / FILE for level in levels if (level / FILE).is_file()), None)
    return None if path is None else read_own_keypoints(path)


def read_own_keypoints(path: Path) -> OwnKeypoints:
    """Read what own keypoints mean.

    Raises:
        FileDamaged: see ``find_own_keypoints``.
    """
    content = read_json(path)
    values: dict[str, Any] = content if isinstance(content, dict) else {}
    landmarks, order, points = values.get("landmarks", {}), values.get("order", []), values.get("points", {})
    well_formed = isinstance(landmarks, dict) and isinstance(points, dict) and _are_texts(order)
    if not well_formed or not (landmarks or order or points):
        hint = 'Such as {"landmarks": {"kneeR_lateral": "right_knee", "tail": null}, "points": {"watch": {"bone": '
        hint += '"left_forearm"}}}; "order" lists column names.'
        raise FileDamaged("The file does not define the keypoints.", where=str(path), hint=hint)
    known = sorted({name for s in JointSet if s is not JointSet.SMPL_24 for name in s.keypoints} | {*HAND_LANDMARKS})
    unknown = [f"'{name}' is '{m}'" for name, m in landmarks.items() if m is not None and m not in known]
    if unknown:
        hint = f"Landmarks are {', '.join(known)}; null leaves a point out."
        raise FileDamaged(f"There is no such landmark: {', '.join(unknown[:6])}.", where=str(path), hint=hint)
    return OwnKeypoints(landmarks, tuple(order or ()), str(path), _own_points(points, landmarks, str(path)))


def _own_points(points: Mapping[str, Any], landmarks: Mapping[str, Any], where: str) -> tuple[OwnPoint, ...]:
    """Return the points on bones."""
    bones = {name: value.get("bone") if isinstance(value, dict) else None for name, value in points.items()}
    unknown = [f"'{name}' is on '{bone}'" for name, bone in bones.items() if bone not in BONES]
    if unknown:
        hint = f"Bones are {', '.join(BONES)}."
        raise FileDamaged(f"There is no such bone: {', '.join(unknown[:6])}.", where=where, hint=hint)
    if both := sorted(set(bones) & set(landmarks)):
        raise FileDamaged(f"Both a landmark and a point on a bone: {', '.join(both)}.", where=where)
    return tuple(OwnPoint(name, str(bone)) for name, bone in bones.items())


def _means(person: np.ndarray, columns: Sequence[Sequence[int]]) -> np.ndarray:
    """Return (L, 3) each the mean of several of (K, 3) points, as sure as the least sure; unseen if one of them is."""
    return np.stack([np.concatenate([person[list(c), :2].mean(0), [person[list(c), 2].min()]]) for c in columns])


def _are_texts(values: Any) -> bool:
    return isinstance(values, list) and all(isinstance(value, str) for value in values)
