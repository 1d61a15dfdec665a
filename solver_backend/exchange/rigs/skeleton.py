"""Represent a skeleton as a tree of bone positions, and define the roles of bones."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence

import numpy as np

from ..body_layout import SMPL
from ..plain_text import pairs


class Skeleton:
    """Bones with their head positions at rest, in any unit and axes.

    Args:
        heads: (3,) position of each bone's head.
        parents: parent name of each bone. Roots have none.
    """

    def __init__(self, heads: Mapping[str, Sequence[float] | np.ndarray], parents: Mapping[str, str]) -> None:
        self.names = tuple(heads)
        self.heads = np.array([heads[name] for name in self.names], np.float64).reshape(-1, 3)
        index = {name: i for i, name in enumerate(self.names)}
        self.parents = [index.get(parents[name], -1) if name in parents else -1 for name in self.names]
        self.children: list[list[int]] = [[] for _ in self.names]
        for bone, parent in enumerate(self.parents):
            if parent >= 0:
                self.children[parent].append(bone)
        self.size = float(np.ptp(self.heads, axis=0).max()) if len(self.names) else 0.0
        self.reach = np.zeros(len(self.names))
        """(N,) length of the longest downward path from each bone."""
        self.counts = np.ones(len(self.names), dtype=int)
        """(N,) number of bones in each bone's subtree, including the bone itself."""
        for bone in reversed(self._from_roots()):
            below = self.children[bone]
            self.counts[bone] += sum(self.counts[child] for child in below)
            self.reach[bone] = max((self.reach[child] + self.distance(bone, child) for child in below), default=0.0)

    def distance(self, a: int, b: int) -> float:
        """Return the distance between two bone heads."""
        return math.dist(self.heads[a], self.heads[b])

    def main_path(self, bone: int) -> list[int]:
        """Return the bones on the longest downward path from a bone, including the bone itself."""
        path = [bone]
        while self.children[path[-1]]:
            path.append(max(self.children[path[-1]], key=lambda c: self.reach[c] + self.distance(path[-1], c)))
        return path

    def above(self, bone: int) -> list[int]:
        """Return a bone and its ancestors, root last."""
        line = [bone]
        while self.parents[line[-1]] >= 0:
            line.append(self.parents[line[-1]])
        return line

    def below(self, bone: int) -> list[int]:
        """Return a bone and its descendants."""
        found = [bone]
        for one in found:
            found.extend(self.children[one])
        return found

    def pairs(self) -> list[tuple[int, int]]:
        """Return pairs of similar branches that share a parent but start at different positions."""
        found = []
        for children in self.children:
            for i, a in enumerate(children):
                for b in children[i + 1 :]:
                    reach = max(self.reach[a], self.reach[b])
                    alike = abs(self.reach[a] - self.reach[b]) < _ALIKE * reach and self._equally_far(a, b)
                    if alike and abs(self.counts[a] - self.counts[b]) <= _ALIKE_COUNT * max(self.counts[a], 4):
                        found.append((a, b))
        return found

    def _equally_far(self, a: int, b: int) -> bool:
        parent = self.parents[a]
        return abs(self.distance(a, parent) - self.distance(b, parent)) < _ALIKE * self.size

    def _from_roots(self) -> list[int]:
        order = [bone for bone, parent in enumerate(self.parents) if parent < 0]
        for bone in order:
            order.extend(self.children[bone])
        return order


_ALIKE = 0.06  # Largest relative difference between left and right. Captured skeletons reach 2 to 3 %.
_ALIKE_COUNT = 0.25  # The same limit for the number of bones. One hand may hold a prop.


SIDES = ("left", "right")
CHAINS = ("spine", "neck")
"""Parts that consist of several bones. ``spine_1`` is the lowest."""
_PARTS = pairs("clavicle collar upper_arm shoulder forearm elbow hand wrist thigh hip shin knee foot ankle toe foot")
_OF_A_SIDE = {part: SMPL.both(joint) for part, joint in _PARTS.items()}
"""Indices of the left and right joint that rotate the bones of each paired part."""
FINGERS = ("thumb", "index", "middle", "ring", "pinky")
"""Fingers of a hand. ``left_index_1`` is the bone next to the knuckle. Palm bones have no role."""
JOINT_OF = {
    **dict(zip(("pelvis", "head"), SMPL.numbers("pelvis", "head"), strict=True)),
    **{f"{side}_{part}": pair[s] for part, pair in _OF_A_SIDE.items() for s, side in enumerate(SIDES)},
}
"""SMPL joint that rotates each role's bone. Spine and neck bones are between joints."""
HELPER_OF = {f"{part}_ik": (part, part) for part in ("hand", "foot", "toe")}
HELPER_OF |= {"elbow_pole": ("upper_arm", "forearm"), "knee_pole": ("thigh", "shin")}
"""Controls of an IK limb: the part that each control rotates with, and the part at its position."""
LIMB_OF_POLE = {"elbow_pole": "arm", "knee_pole": "leg"}
LIMBS = {
    f"{side}_{name}": (f"{side}_{upper}", f"{side}_{lower}", f"{side}_{end}")
    for name, (upper, lower, end) in {"arm": ("upper_arm", "forearm", "hand"), "leg": ("thigh", "shin", "foot")}.items()
    for side in SIDES
}
"""Upper bone, lower bone and end of each limb that has one hinge."""
_KNOWN = re.compile(
    rf"root|carrier|pelvis|head|({'|'.join(CHAINS)})_[1-9]\d?"
    rf"|({'|'.join(SIDES)})_({'|'.join((*_OF_A_SIDE, *HELPER_OF))}|({'|'.join(FINGERS)})_[1-4])"
)


def is_role(name: str) -> bool:
    """Return whether a name is a role that a bone can have, such as ``pelvis``."""
    return _KNOWN.fullmatch(name) is not None


def is_of_a_side(part: str) -> bool:
    """Return whether a body part exists on both sides."""
    return part in _OF_A_SIDE or part in HELPER_OF


def is_of_a_finger(role: str) -> bool:
    """Return whether a role denotes a finger bone."""
    return role.rstrip("1234").rstrip("_").rpartition("_")[2] in FINGERS


def chain_roles(bones: dict[str, str], chain: str) -> list[str]:
    """Return the roles in a chain that have a bone, from the pelvis upwards."""
    found = (role for role in bones if role.startswith(f"{chain}_"))
    return sorted(found, key=lambda role: int(role.rpartition("_")[2]))


def order_of(role: str) -> tuple[int, str]:
    """Return the sort key of a role for lists shown to users: trunk, arms, legs, helpers."""
    part = re.sub(r"^(left|right)_|_\d+$", "", role)
    parts = ("root", "carrier", "pelvis", "spine", "neck", "head", *_OF_A_SIDE, *FINGERS, *HELPER_OF)
    return parts.index(part), role


_RATIO = 2.5  # Largest length ratio between a limb's two bones. No person exceeds it.
_LENGTHS_ALIKE = 0.3  # Largest relative length difference between left and right limbs.


def is_plausible(bones: dict[str, str], skeleton: Skeleton) -> bool:
    """Return whether the bones assigned to roles have the lengths, symmetry and directions of a person."""
    index = {name: i for i, name in enumerate(skeleton.names)}
    places = {role: skeleton.heads[index[bone]] for role, bone in bones.items() if bone in index}
    lengths: dict[str, float] = {}
    for limb, roles in LIMBS.items():
        if not set(roles) <= places.keys():
            continue
        upper, lower = (float(np.linalg.norm(places[b] - places[a])) for a, b in (roles[:2], roles[1:]))
        if upper > _RATIO * lower or lower > _RATIO * upper:
            return False
        lengths[limb] = upper + lower
    for kind in ("arm", "leg"):
        both = [lengths[f"{side}_{kind}"] for side in SIDES if f"{side}_{kind}" in lengths]
        if both and max(both) - min(both) > _LENGTHS_ALIKE * max(both):
            return False
    return _legs_go_down(places)


def _legs_go_down(places: dict[str, np.ndarray]) -> bool:
    parts = ("thigh", "foot", "upper_arm")
    if not all(f"{side}_{part}" in places for side in SIDES for part in parts):
        return True
    hips, feet, shoulders = (np.mean([places[f"{side}_{part}"] for side in SIDES], axis=0) for part in parts)
    leg, trunk = feet - hips, shoulders - hips
    return bool(leg @ trunk <= 0.5 * np.linalg.norm(leg) * np.linalg.norm(trunk))
