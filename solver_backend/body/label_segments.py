"""The bone that a label or its prefix names without a place on it: ``ArmL:Marker2``, ``R_Thigh_Cluster_3``."""

from __future__ import annotations

from solver_backend.body.label_words import LabelWords, bare_label
from solver_backend.body.marker_layouts import load_layouts

_LIMBS = {
    "ARM": "shoulder", "UPPERARM": "shoulder", "HUMERUS": "shoulder", "FOREARM": "elbow", "HAND": "wrist",
    "THIGH": "hip", "FEMUR": "hip", "SHANK": "knee", "TIBIA": "knee", "FOOT": "ankle",
}  # fmt: skip
"""The joint where the bone of each word begins, without its side."""
_MIDLINE = {"HEAD": "head", "PELVIS": "pelvis", "SACRUM": "pelvis"}
_PLACES = frozenset({"KNEE", "ANKLE", "MALLEOLUS", "ELBOW", "WRIST", "EPICONDYLE", "STYLOID", "ACROMION", "SHOULDER"})
"""Words of joints, beside which a bone's word shows nothing of the side of the joint."""


def named_bone(label: str) -> str | None:
    """Return the joint at the beginning of the bone that a label names, its subject's name where it names none itself.

    None where neither names one bone, or a limb's without its side.
    """
    words = load_layouts().words
    prefix = label.rpartition(":")[0]
    return _bone(bare_label(label), words) or (_bone(prefix, words) if prefix else None)


def _bone(text: str, words: LabelWords) -> str | None:
    side, found = words.known_in(text)
    if found & _PLACES:
        return None
    limbs = {joint for word in found if (joint := _LIMBS.get(word))}
    middle = {joint for word in found if (joint := _MIDLINE.get(word))}
    if len(limbs) + len(middle) != 1 or (limbs and not side):
        return None
    return f"{'left' if side == 'L' else 'right'}_{limbs.pop()}" if limbs else middle.pop()
