"""Recognise joint centre labels of inertial suits, 3D keypoints and skeleton exports."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import cache
from itertools import product

from solver_backend.body.label_words import Affixes, bare_label, prefixes, suffixes
from solver_backend.body.marker_layouts import label_key

JOINT, KEYPOINT = "=", "~"  # Prefixes for body joints and for detector keypoints.
LEAST_SHARE = 0.85  # Smallest share of labels in one vocabulary, because marker sets and skeletons share some words.
_FINGER = re.compile(  # Finger bones in their different numbering styles: LeftHandIndex1, LeftInHandRing, L Finger01.
    r"(in)?(hand)?(thumb|index|middle|ring|pinky|little|forefinger|finger)(finger|proximal|distal)?\w{0,4}"
)
_WORDS: dict[str, dict[str, str]] = {  # Midline locations by words. Empty if conventions differ too much.
    "bones": {
        "hips hip": "=pelvis", "pelvis": "=pelvis", "root": "=pelvis", "neck": "=neck", "head": "=head",
        "headend headtop headtopend headnub": "~head_top",
        "spine spine1 spine2 spine3 spine4 spinelow spinemid spinetop lowerback chest chest1 chest2 chest3 chest4 body "
        "upperback thorax neck1 abdomen torso trunk l5 l3 t12 t8": "",
    },
    "joints": {
        "nose": "~nose", "neck": "~neck", "head headtop topofhead": "~head_top",
        "midhip chip hip hipcenter hipcentre pelvis hips root spinebase": "~mid_hip",
        "spinemid spineshoulder spinenaval spinechest": "",
        "thorax spine spine1 spine2 spine3 chest mouth belly uppernecks upperneck jaw body": "",
    },
}  # fmt: skip
_SIDED: dict[str, dict[str, str]] = {  # Sided locations by words. A bone is named after its first joint.
    "bones": {
        "upleg upperleg thigh femur hip": "=hip", "leg lowerleg lowleg shin shank calf tibia": "=knee",
        "foot ankle": "=ankle", "toe toe0 toes toebase ball": "=foot", "toeend toesend toetip toenub": "~big_toe",
        "heel": "~heel", "arm uarm uparm upperarm humerus shldr": "=shoulder",
        "forearm larm lowerarm lowarm radius": "=elbow",
        "hand": "=wrist", "finger fingers fingerbase": "=hand",
        "shoulder collar clavicle fingerend fingersend handend thumb thumbend wrist": "",
    },
    "joints": {
        "hip hjc": "~hip", "knee kjc": "~knee", "ankle ajc": "~ankle", "shoulder sjc": "~shoulder",
        "elbow ejc": "~elbow", "wrist wjc": "~wrist", "bigtoe footindex toe": "~big_toe",
        "smalltoe littletoe": "~small_toe", "heel": "~heel", "eye": "~eye", "ear": "~ear", "index": "~index",
        "pinky": "~pinky", "thumb": "~thumb",
        "foot": "=foot", "eyeinner eyeouter mouth collar clavicle hand handtip": "",
    },
}  # fmt: skip
_NEEDED = {  # One of these chains must exist on both sides. Joints also need hips or a nose.
    "bones": (("=hip", "=knee", "=ankle"), ("=shoulder", "=elbow", "=wrist")),
    "joints": (("~hip", "~knee", "~ankle"), ("~shoulder", "~elbow", "~wrist")),
}
_FACE = {"~nose", "~eye", "~ear", "~small_toe"}  # Detector keypoints that no skeleton has.
_OTHERWISE = {"mid_hip": "pelvis", "head_top": "head", "big_toe": "foot"}  # Joints for keypoints with equal words.


def joint_centre_places(labels: Sequence[str]) -> dict[str, str]:
    """Map labels of a skeleton's joint centres to locations, or to "" if a label is not used.

    A location is a joint such as ``=left_knee`` or a keypoint such as ``~left_knee``. The result is empty if fewer than
    ``LEAST_SHARE`` of the labels are words from one vocabulary, or if no limb exists on both sides.
    """
    bare = tuple(map(bare_label, labels))
    for vocabulary, affixes in product(_WORDS, (Affixes(), *prefixes(bare), *suffixes(bare))):
        found = {label: _place(affixes.bare(label), vocabulary) for label in labels}
        places = {label: place for label, place in found.items() if place is not None}
        if len(places) >= LEAST_SHARE * len(labels) and _is_skeleton(set(places.values()), vocabulary):
            return _without_repeats(_as_joints(places) if vocabulary == "joints" else places)
    return {}


def is_joint_centre(place: str) -> bool:
    """Return whether a location is a joint or a keypoint inside the body, not on the skin."""
    return place[:1] in (JOINT, KEYPOINT)


def _place(label: str, vocabulary: str) -> str | None:
    key = label_key(label).lower()
    midline, sided = _tables(vocabulary)
    if (place := midline.get(key)) is not None:
        return place
    for side in ("left", "right", "l", "r"):
        for part in (key.removeprefix(side), key.removesuffix(side)):
            if part != key and part in sided:
                place = sided[part]
                return place and f"{place[0]}{'left' if side[0] == 'l' else 'right'}_{place[1:]}"
            if part != key and _FINGER.fullmatch(part):
                return ""
    return None


@cache
def _tables(vocabulary: str) -> tuple[dict[str, str], dict[str, str]]:
    midline, sided = (
        {word: place for several, place in words[vocabulary].items() for word in several.split()}
        for words in (_WORDS, _SIDED)
    )
    return midline, sided


def _is_skeleton(places: set[str], vocabulary: str) -> bool:
    def both(part: str) -> bool:
        return {f"{part[0]}{side}_{part[1:]}" for side in ("left", "right")} <= places

    chains = [all(both(part) for part in chain) for chain in _NEEDED[vocabulary]]
    return any(chains) and (vocabulary == "bones" or both("~hip") or "~nose" in places)


def _as_joints(places: dict[str, str]) -> dict[str, str]:
    """Convert keypoint locations to joint locations, unless keypoints of the face show that a detector was used.

    If no label is an ankle, the foot at the end of a leg is used as the ankle (Human3.6M).
    """
    if {re.sub("left_|right_", "", place) for place in places.values()} & _FACE:
        return places

    ankles = any(place.endswith("_ankle") for place in places.values())

    def joint(place: str) -> str:
        if not ankles and place.endswith("_foot"):
            return place.replace("_foot", "_ankle")
        for keypoint, name in _OTHERWISE.items():
            place = place.replace(keypoint, name)
        return place if place.endswith("heel") else place.replace(KEYPOINT, JOINT)

    return {label: joint(place) for label, place in places.items()}


def _without_repeats(places: dict[str, str]) -> dict[str, str]:
    """Replace a location by "" if an earlier label already has it."""
    first = {place: label for label, place in reversed(places.items())}
    return {label: place if first[place] == label else "" for label, place in places.items()}
