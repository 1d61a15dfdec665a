"""Map named keypoints to a joint set, and apply keypoint definitions of the user."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.exchange.errors import FileDamaged, KeypointCountMismatch
from solver_backend.exchange.joint_sets import HAND_POINTS, NUM_HAND_POINTS, SIDES
from solver_backend.io.detections.camera_frames import CameraFrames, Hands, People
from solver_backend.io.files import read_json
from solver_backend.types import BONES, UNSEEN_POINT, JointSet, OwnPoint

LEAST_KNOWN = 8  # Smallest number of known body keypoints. Fewer do not determine a pose.
_SIDES = {word: side for side, words in enumerate(("l left lt", "r right rt")) for word in words.split()}
"""Index in ``SIDES`` of each word that means a side."""
_PARTS = {"foot": "ankle", "hand": "wrist", "bigtoe": "big_toe", "smalltoe": "small_toe", "littletoe": "small_toe"}
_PARTS |= {"toe": "big_toe", **dict.fromkeys(("pelvis", "midhip", "hipcenter", "hipcentre"), "mid_hip")}
_PARTS |= dict.fromkeys(("headtop", "topofhead", "crown", "head"), "head_top")
"""Other words for the parts of joint sets, without separators."""
_WHOLE = ("neck", "nose", "mid_hip", "head_top", "upper_neck", "thorax", "spine")
_NAMED_SETS = tuple(joint_set for joint_set in JointSet if joint_set is not JointSet.SMPL_24)
_SIDED = tuple(
    dict.fromkeys(name.removeprefix("left_") for s in JointSet for name in s.keypoints if name.startswith("left_"))
)
"""Names of body parts that exist on both sides."""


@dataclass(frozen=True)
class NamedKeypoints:
    """Map from the columns of a file to the keypoints of a joint set."""

    joint_set: JointSet  # Joint set that contains most of the names.
    columns: tuple[int, ...]  # (K,) column of each keypoint in the set, or -1 if the file does not contain it.
    unknown: tuple[str, ...]  # Names that are not in the joint set.
    own: tuple[int, ...] = ()  # (N,) column of each user-defined point, or -1 if absent.

    @property
    def found(self) -> frozenset[str]:
        """The joint set's keypoints that the file contains."""
        return frozenset(n for n, c in zip(self.joint_set.keypoints, self.columns, strict=True) if c >= 0)

    def ordered(self, person: np.ndarray) -> np.ndarray:
        """Reorder a person's points to (K + N, 3): joint set, then user-defined points. Missing points are NaN."""
        return np.concatenate([person, [UNSEEN_POINT]])[[*self.columns, *self.own]]


def match_cameras(
    names: Sequence[tuple[str, ...]], given: JointSet | None = None, own: Sequence[str] = (), *, where: str = ""
) -> list[NamedKeypoints]:
    """Map each camera's keypoint names to the best joint set. Return [] if the files contain no names.

    Args:
        names: keypoint names of each of the C cameras. Cameras may have different keypoints.
        given: joint set that the user chose.
        own: names of the user-defined points, which do not belong to a joint set.
        where: file or folder, for errors.

    Raises:
        KeypointCountMismatch: only some files name their keypoints, or fewer than ``LEAST_KNOWN`` names are known.
    """
    if not any(names):
        return []
    if not all(names):
        hint = "Export all cameras in one format."
        raise KeypointCountMismatch("Only some of the camera files name their keypoints.", where=where, hint=hint)
    everywhere = list(dict.fromkeys(n for camera in names for n in camera if n not in own))
    joint_set = _best_set(everywhere, given, where)
    return [_in_set(camera, joint_set, own) for camera in names]


def _best_set(names: list[str], given: JointSet | None, where: str) -> JointSet:
    plain = [plain_name(name) for name in names]
    # If several sets have the same body, prefer the one without hands, because only body points are named here.
    sets = (given,) if given is not None else tuple(s for s in _NAMED_SETS if s.num_keypoints in s.num_written)
    known = {s: len(set(s.keypoints) & set(plain)) for s in sets}
    best = max(sets, key=lambda s: (known[s], -s.num_keypoints))
    if known[best] < LEAST_KNOWN:
        strange = next((name for name, p in zip(names, plain, strict=True) if p not in best.keypoints), names[0])
        what = f"Of the {len(names)} named keypoints only {known[best]} are known: {', '.join(names[:12])}."
        hint = f'Name them in a keypoints.json file next to the recording, such as {{"landmarks": {{"{strange}": '
        hint += f'"left_knee"}}}}. Landmarks: {", ".join(JointSet.COCO_17.keypoints)}, ...'
        raise KeypointCountMismatch(what, where=where, hint=hint)
    return best


def _in_set(names: Sequence[str], joint_set: JointSet, own: Sequence[str]) -> NamedKeypoints:
    plain = ["" if name in own else plain_name(name) for name in names]
    columns = tuple(plain.index(name) if name in plain else -1 for name in joint_set.keypoints)
    unknown = tuple(n for n, p in zip(names, plain, strict=True) if p not in joint_set.keypoints and n not in own)
    return NamedKeypoints(joint_set, columns, unknown, tuple(names.index(n) if n in names else -1 for n in own))


def plain_name(name: str) -> str:
    """Convert a keypoint name to the form in joint sets, such as ``elbow_L`` to ``left_elbow``."""
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])|(?<=^[LR])(?=[A-Z][a-z])", "_", name.strip())
    words = [word for word in re.split(r"[^a-z]+", spaced.lower()) if word]
    sides = [_SIDES[word] for word in words if word in _SIDES]
    rest = "".join(word for word in words if word not in _SIDES)
    if not sides and rest[:1] in "lr" and _part(rest[1:]) in _SIDED and _part(rest) not in _SIDED:
        sides, rest = [_SIDES[rest[0]]], rest[1:]
    part = _part(rest)
    return f"{SIDES[sides[0]]}_{part}" if len(sides) == 1 and part in _SIDED else part


def _part(word: str) -> str:
    part = _PARTS.get(word, word)
    return next((known for known in (*_SIDED, *_WHOLE) if known.replace("_", "") == part), part)


LEAST_POINTS = 6  # Smallest number of named points that form a hand.
_WORDS = ("thumb", "index forefinger fore pointer", "middle mid", "ring", "pinky little pinkie")
_FINGERS = {word: finger for finger, words in enumerate(_WORDS) for word in words.split()}
_OF_THUMB = {"cmc": 0, "mcp": 1, "ip": 2, "dip": 2, "tip": 3, "end": 3}
_OF_FINGER = {"mcp": 0, "knuckle": 0, "base": 0, "pip": 1, "dip": 2, "tip": 3, "end": 3}
"""Index along a finger for each word in a name. In a name with a number, 1 is the knuckle or the base of the thumb."""
_ROOTS = ({"hand", "root"}, {"hand", "wrist"})  # Words for a hand's wrist point.
_NOISE = {"finger", "hand", "joint", "keypoint", "kp"}
HAND_LANDMARKS = tuple(f"{side}_{point}" for side in SIDES for point in HAND_POINTS[1:])
"""Names of the hand points except the wrists."""


def hand_point(name: str) -> tuple[int, int] | None:
    """Return the side (0 left, 1 right) and the index in ``HAND_POINTS`` of a named point, or None.

    A finger without a joint or number, such as the body keypoint ``left_index``, is not a hand point.
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


def with_named_hands(frames: CameraFrames) -> CameraFrames:
    """Move the named hand points of a camera to ``hands``, and keep the other keypoints.

    If a hand has no wrist point, the body's wrist is used.
    """
    names = frames.keypoints
    points = [hand_point(name) for name in names]
    index = np.full((len(SIDES), NUM_HAND_POINTS), -1)
    for column, point in enumerate(points):
        if point is not None and index[point] < 0:
            index[point] = column
    index[(index >= 0).sum(axis=1) < LEAST_POINTS] = -1
    if (index < 0).all():
        return frames
    kept = [column for column, point in enumerate(points) if point is None or index[point] < 0]
    for side, name in enumerate(SIDES):
        if index[side, 0] < 0 <= index[side].max():
            wrists = (column for column, written in enumerate(names) if plain_name(written) == f"{name}_wrist")
            index[side, 0] = next(wrists, -1)

    def people(row: int) -> People:
        return [person[kept] if len(person) == len(names) else person for person in frames.people(row)]

    def hands(row: int) -> Hands:
        whole = [person if len(person) == len(names) else None for person in frames.people(row)]
        return [None if person is None else np.concatenate([person, [UNSEEN_POINT]])[index] for person in whole]

    return replace(frames, people=people, hands=hands, keypoints=tuple(names[column] for column in kept))


FILE = "keypoints.json"


@dataclass(frozen=True)
class OwnKeypoints:
    """Keypoint definitions in the user's ``keypoints.json``."""

    landmarks: Mapping[str, str | None]
    """Landmark for each user-defined name, or None for an ignored point. Other names are matched as usual."""
    order: tuple[str, ...] = ()
    """Names of the columns if the files do not name them."""
    where: str = ""
    """File with the definitions, for errors."""
    points: tuple[OwnPoint, ...] = ()
    """User-defined points at a fixed position on a bone that are not landmarks."""

    def apply(self, frames: CameraFrames) -> CameraFrames:
        """Rename user-defined points to landmarks. Several points for the same landmark are averaged.

        Raises:
            KeypointCountMismatch: a person's number of points differs from the number of names.
        """
        names = frames.keypoints or self.order
        if not names:
            return frames
        columns: dict[str, list[int]] = {}
        for column, name in enumerate(names):
            if (meant := self.landmarks.get(name, name)) is not None:
                columns.setdefault(meant, []).append(column)

        def people(row: int) -> People:
            found = frames.people(row)
            for person in found:
                if len(person) != len(names):
                    hint = "List every column's name under 'order'."
                    what = f"A person has {len(person)} keypoints, but {self.where} names {len(names)}."
                    raise KeypointCountMismatch(what, where=frames.where(row), hint=hint)
            # The mean of several points gets their lowest confidence. It is missing if one of them is missing.
            means = [[(*p[c, :2].mean(0), p[c, 2].min()) for c in columns.values()] for p in found]
            return [np.array(person) for person in means]

        return replace(frames, people=people, keypoints=tuple(columns))


def find_own_keypoints(levels: Sequence[Path]) -> OwnKeypoints | None:
    """Read the nearest ``keypoints.json``, or return None if there is none."""
    path = next((level / FILE for level in levels if (level / FILE).is_file()), None)
    if path is None:
        return None
    where, content = str(path), read_json(path)
    values: dict[str, Any] = content if isinstance(content, dict) else {}
    landmarks, order, points = values.get("landmarks", {}), values.get("order", []), values.get("points", {})
    well_formed = isinstance(landmarks, dict) and isinstance(points, dict) and isinstance(order, list)
    if not (well_formed and all(isinstance(n, str) for n in order) and (landmarks or order or points)):
        hint = 'Such as {"landmarks": {"kneeR_lateral": "right_knee", "tail": null}, "points": {"watch": {"bone": '
        hint += '"left_forearm"}}}, where "order" lists column names.'
        raise FileDamaged("The file does not define the keypoints.", where=where, hint=hint)
    known = sorted({name for s in _NAMED_SETS for name in s.keypoints} | {*HAND_LANDMARKS})
    if unknown := [f"'{name}' is '{m}'" for name, m in landmarks.items() if m is not None and m not in known]:
        hint = f"Landmarks are {', '.join(known)}. null ignores a point."
        raise FileDamaged(f"There is no such landmark: {', '.join(unknown[:6])}.", where=where, hint=hint)
    bones = {name: value.get("bone") if isinstance(value, dict) else None for name, value in points.items()}
    if unknown := [f"'{name}' is on '{bone}'" for name, bone in bones.items() if bone not in BONES]:
        hint = f"Bones are {', '.join(BONES)}."
        raise FileDamaged(f"There is no such bone: {', '.join(unknown[:6])}.", where=where, hint=hint)
    if both := sorted(set(bones) & set(landmarks)):
        raise FileDamaged(f"Both a landmark and a point on a bone: {', '.join(both)}.", where=where)
    return OwnKeypoints(landmarks, tuple(order), where, tuple(OwnPoint(name, str(b)) for name, b in bones.items()))
