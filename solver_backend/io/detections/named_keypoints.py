"""Keypoints that files name themselves, in the order of the joint set that has most of them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from solver_backend.exchange.errors import KeypointCountMismatch
from solver_backend.types import JointSet

LEAST_KNOWN = 8
"""Keypoints of a body that must be among the names: fewer do not hold a pose."""
_SIDES = {"l": "left", "left": "left", "lt": "left", "r": "right", "right": "right", "rt": "right"}
_PARTS = {
    "foot": "ankle", "hand": "wrist", "bigtoe": "big_toe", "smalltoe": "small_toe", "littletoe": "small_toe",
    "toe": "big_toe", "pelvis": "mid_hip", "midhip": "mid_hip", "hipcenter": "mid_hip", "hipcentre": "mid_hip",
    "headtop": "head_top", "topofhead": "head_top", "crown": "head_top", "head": "head_top",
}  # fmt: skip
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
        raise KeypointCountMismatch(
            "Only some of the cameras' files name their keypoints.", where=where,
            hint="Export all cameras in one format.",
        )  # fmt: skip
    everywhere = dict.fromkeys(n for camera in names for n in camera if n not in own)
    joint_set = match_keypoints(tuple(everywhere), given, where=where).joint_set
    return [_in_set(camera, joint_set, own) for camera in names]


def match_keypoints(names: tuple[str, ...], given: JointSet | None = None, *, where: str = "") -> NamedKeypoints:
    """Return how a file's names map to a joint set.

    Args:
        names: as the file writes them: ``LeftShoulder``, ``l_shoulder``, ``shoulder_R`` and ``left_shoulder`` are one.
        given: the set that the user wants; None takes the one that has most of the names.
        where: the file, for errors.

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
        raise KeypointCountMismatch(
            f"Of the {len(names)} named keypoints only {known[best]} are known: {', '.join(names[:12])}.", where=where,
            hint="Name them in a file keypoints.json beside the recording, such as "
            f'{{"landmarks": {{"{strange}": "left_knee"}}}}. Landmarks: {", ".join(JointSet.COCO_17.keypoints)}, ...',
        )  # fmt: skip
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
