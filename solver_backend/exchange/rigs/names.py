"""Recognise the roles of bones from their names: sides from affixes, parts from words."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from functools import lru_cache
from itertools import pairwise

import numpy as np

from .skeleton import FINGERS, LIMBS, SIDES, Skeleton


def _set(text: str) -> frozenset[str]:
    return frozenset(text.split())


_WORDS = {
    "pelvis": ("pelvis", "hips", "hip", "cog", "root pelvis"),
    "head": ("head", "skull"),
    "clavicle": ("clavicle", "collar", "collarbone", "shoulder"),
    "upper_arm": ("upperarm", "upper arm", "uparm", "arm upper", "bicep", "arm", "humerus", "shldr"),
    "forearm": (
        "forearm",
        "fore arm",
        "lowerarm",
        "lower arm",
        "loarm",
        "low arm",
        "arm lower",
        "elbow",
        "ulna",
        "radius",
    ),
    "hand": ("hand", "wrist"),
    "thigh": ("thigh", "upperleg", "upper leg", "upleg", "up leg", "leg upper", "femur", "hip"),
    "shin": ("shin", "calf", "lowerleg", "lower leg", "loleg", "low leg", "leg lower", "knee", "leg", "tibia"),
    "foot": ("foot", "ankle"),
    "toe": ("toe", "toes", "ball", "toebase", "toe base"),
}
"""Words for each part, most reliable first. Words that fit several parts come last."""
_CHAIN_WORDS = {"spine": ("spine", "chest", "torso", "abdomen", "upperchest", "back", "waist"), "neck": ("neck",)}
_NOT_BODY = _set(
    "ik pole target mch org vis ctrl twist roll helper end nub tip finger thumb index middle ring pinky little "
    "palm metacarpal eye jaw ear hair tongue breast skirt cloth prop weapon tweak master heel"
)
"""Words in the names of bones that do not belong to these parts."""
_LEFT = _set("l left lft lt li links gauche izq izquierda izquierdo sx sinistra sinistro esquerda esquerdo")
_RIGHT = _set("r right rgt rt re rechts droite droit der derecha derecho dx destra destro direita direito")
"""Words for sides in English, German, French, Spanish, Italian and Portuguese."""
_MIDDLE = _set("c m")  # Letters for centre and middle.
_GLUED = ("left", "right", "l", "r")
"""Side names that may precede a part without a separator, longest first: ``lhumerus``, ``righthand``."""
_OF_A_SIDE = frozenset(
    word.replace(" ", "") for part, words in _WORDS.items() if part not in ("pelvis", "head") for word in words
) | {"finger", "fingers", "thumb", "index", "middle", "ring", "pinky", "little"}
"""Words that may follow a side name without a separator."""
_PREFIXES = _set("def bip bip001 bip01 mixamorig character j jnt joint bone bn c m fk")


def guess_roles(bones: Iterable[str], parents: dict[str, str]) -> dict[str, str]:
    """Return the most likely bone for each role, judged by names. A limb's bones must be on one branch.

    Args:
        parents: parent name of each bone. Roots have none.
    """
    bones = list(bones)
    words = {bone: _words(bone) for bone in bones}
    found: dict[str, str] = {}
    for side in ("", *SIDES):
        for part, synonyms in _WORDS.items():
            if (part in ("pelvis", "head")) == (side == ""):
                best = min(_scored(words, side, synonyms, parents), default=None)
                if best is not None:
                    found[f"{side}_{part}" if side else part] = best[-1]
    _untie(found)
    for side in SIDES:  # "shldr" is DAZ's upper arm, but a clavicle if another bone is named as the arm
        above = parents.get(found.get(f"{side}_upper_arm", ""), "")
        if words.get(above) == (side, ("shldr",)) and above not in found.values():
            found.setdefault(f"{side}_clavicle", above)
    for roles in LIMBS.values():
        _cut_where_it_does_not_hang(found, roles, parents)
    for chain, synonyms in _CHAIN_WORDS.items():
        line = sorted(_scored(words, "", synonyms, parents), key=lambda entry: _depth(entry[-1], parents))
        taken = [bone for *_, bone in line if bone not in found.values()]
        found |= {f"{chain}_{i + 1}": bone for i, bone in enumerate(_one_line(taken, parents))}
    return found


def names_part(bone: str, part: str) -> bool:
    """Return whether a bone name denotes exactly this body part."""
    words = words_of(bone)
    if _NOT_BODY & set(words):
        return False
    synonyms = {word.replace(" ", "") for word in (*_WORDS.get(part, ()), *_CHAIN_WORDS.get(part, ()))}
    return "".join(words) in synonyms


def side_of_name(bone: str) -> str:
    """Return the side in a bone name: ``left``, ``right`` or ""."""
    return _words(bone)[0]


def words_of(bone: str) -> tuple[str, ...]:
    """Return the lower-case words in a bone name without its side and prefixes."""
    return _words(bone)[1]


@lru_cache(maxsize=4096)
def _words(bone: str) -> tuple[str, tuple[str, ...]]:
    """Split a name into its side and lower-case words: ``mixamorig:LeftForeArm`` is left, fore, arm."""
    space, _, rest = bone.partition(":")
    if rest and set(words_of(rest)) - _MIDDLE and not side_of_name(space) and not _NOT_BODY & set(words_of(space)):
        return _words(rest)  # without the file's namespace
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])|(?<=[A-Za-z])(?=\d)|(?<=\d)(?=[A-Za-z])", " ", bone)
    parts = [part for word in re.split(r"[^A-Za-z]+|\d+", spaced.lower()) if word for part in _split_off_side(word)]
    left, right = (any(word in parts for word in side) for side in (_LEFT, _RIGHT))
    side = "" if left == right else SIDES[0] if left else SIDES[1]
    kept = [word for word in parts if word not in _LEFT | _RIGHT]
    while len(kept) > 1 and kept[0] in _PREFIXES:
        kept = kept[1:]
    return side, tuple(kept)


def _split_off_side(word: str) -> list[str]:
    for side in _GLUED:
        if word.startswith(side) and word[len(side) :] in _OF_A_SIDE:
            return [side, word[len(side) :]]
    return [word]


def _scored(
    words: dict[str, tuple[str, tuple[str, ...]]], side: str, synonyms: tuple[str, ...], parents: dict[str, str]
) -> Iterator[tuple[int, int, int, str]]:
    """Yield sort keys (rank of the synonym, name length, depth) and names of one side's matching bones.

    A bone matches if its name contains one of the synonyms. The lowest key is the most likely bone.
    """
    for bone, (of_side, kept) in words.items():
        if of_side != side or not kept or _NOT_BODY & set(kept):
            continue
        text = " ".join(kept)
        for rank, synonym in enumerate(synonyms):
            if text in (synonym, synonym.replace(" ", "")) or synonym in (text, text.replace(" ", "")):
                yield rank, len(bone), _depth(bone, parents), bone
                break
            if re.search(rf"\b{synonym}\b", text):
                yield rank + len(synonyms), len(bone), _depth(bone, parents), bone
                break


def _untie(found: dict[str, str]) -> None:
    """Assign bones with ambiguous names such as Shoulder or Arm to the more likely part."""
    for side in SIDES:
        clavicle, upper = f"{side}_clavicle", f"{side}_upper_arm"
        if upper not in found and clavicle in found:
            found[upper] = found.pop(clavicle)
        seen: dict[str, str] = {}
        for role in [role for role in found if role.startswith(side)]:
            if found[role] in seen:
                del found[role]
            else:
                seen[found[role]] = role


def _cut_where_it_does_not_hang(found: dict[str, str], roles: tuple[str, ...], parents: dict[str, str]) -> None:
    for upper, lower in pairwise(roles):
        if upper not in found or lower not in found or found[upper] not in _above(found[lower], parents):
            found.pop(lower, None)


def _one_line(bones: list[str], parents: dict[str, str]) -> list[str]:
    line: list[str] = []
    for bone in bones:
        if not line or line[-1] in _above(bone, parents):
            line.append(bone)
    return line


def _above(bone: str, parents: dict[str, str]) -> list[str]:
    above = []
    while bone in parents:
        bone = parents[bone]
        above.append(bone)
    return above


def _depth(bone: str, parents: dict[str, str]) -> int:
    return len(_above(bone, parents))


_FINGER_WORDS = {finger: finger for finger in ("thumb", "index", "middle", "ring", "pinky")}
_FINGER_WORDS |= {"mid": "middle", "little": "pinky", "pointer": "index"}
_KNUCKLE = 0.2  # Smallest distance from wrist to knuckle in forearm lengths. Closer bones belong to the palm.
_THUMB_DEG = 15.0  # Smallest angle between a thumb and the other fingers.
_CLEAR_GAP = 0.4
"""Smallest distance between neighbouring fingers, relative to the mean distance, for their order to be certain."""
_BONES = 3  # Number of bones per finger that have roles, as in SMPL-H.


def finger_roles(skeleton: Skeleton, hand: int, forearm: float) -> dict[str, int]:
    """Return a hand's unambiguous finger bones, by role without the side (``index_1``)."""
    chains = [skeleton.main_path(child) for child in skeleton.children[hand]]
    chains = [chain for chain in chains if skeleton.distance(hand, chain[-1]) > _KNUCKLE * forearm]
    named = _by_names(skeleton, chains)
    found = named if len(named) == len(chains) else _by_places(skeleton, chains)
    roles = {}
    for finger, chain in found.items():
        bones = chain if finger == "thumb" else [b for b in chain if skeleton.distance(hand, b) > _KNUCKLE * forearm]
        roles |= {f"{finger}_{i + 1}": bone for i, bone in enumerate(bones[:_BONES])}
    return roles


def _by_names(skeleton: Skeleton, chains: list[list[int]]) -> dict[str, list[int]]:
    found: dict[str, list[int]] = {}
    for chain in chains:
        named = {
            _FINGER_WORDS[word] for bone in chain for word in words_of(skeleton.names[bone]) if word in _FINGER_WORDS
        }
        if len(named) == 1 and (finger := named.pop()) not in found:
            found[finger] = chain
    return found


def _by_places(skeleton: Skeleton, chains: list[list[int]]) -> dict[str, list[int]]:
    """Assign five bone chains of a hand to fingers by their positions. Return {} if this is ambiguous.

    The thumb is the chain that points away from the other four. The other chains are the index to little finger, in
    order of their distance from the thumb.
    """
    chains = [chain for chain in chains if len(chain) > 1]
    if len(chains) != len(FINGERS):
        return {}
    lengths = [skeleton.distance(chain[0], chain[-1]) for chain in chains]
    ways = np.array([skeleton.heads[chain[-1]] - skeleton.heads[chain[0]] for chain in chains])
    ways = ways / np.maximum(lengths, 1e-12)[:, None]
    angles = [np.degrees(np.arccos(np.clip(way @ _mean_of_others(ways, i), -1, 1))) for i, way in enumerate(ways)]
    order = np.argsort(angles)
    if angles[order[-1]] < max(_THUMB_DEG, 1.5 * angles[order[-2]]):
        return {}
    thumb, others = chains[order[-1]], [chains[i] for i in order[:-1]]
    middles = np.array([skeleton.heads[chain].mean(0) for chain in others])
    along = _mean_of_others(ways, int(order[-1]))
    across = skeleton.heads[thumb[0]] - middles.mean(0)
    across = across - (across @ along) * along
    aside = middles @ across / max(float(np.linalg.norm(across)), 1e-12)
    rank = np.argsort(-aside)
    gaps = -np.diff(aside[rank])
    if gaps.min() < _CLEAR_GAP * gaps.mean():
        return {}
    return {"thumb": thumb, **{finger: others[i] for finger, i in zip(FINGERS[1:], rank, strict=True)}}


def _mean_of_others(ways: np.ndarray, one: int) -> np.ndarray:
    mean = np.delete(ways, one, axis=0).mean(0)
    return mean / max(float(np.linalg.norm(mean)), 1e-12)
