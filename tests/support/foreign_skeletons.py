"""Skeletons as other programs build them, drawn by us: one figure, and the tree and extra bones of a naming."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

SIDES = ("left", "right")
FINGERS = {"thumb": (0.02, -0.02), "index": (0.08, -0.025), "middle": (0.085, 0.0), "ring": (0.08, 0.022),
            "pinky": (0.072, 0.042)}  # fmt: skip
"""How far along the hand and across it (backwards) the knuckle of each finger is, metres."""


@dataclass(frozen=True)
class ForeignSkeleton:
    """Bones of a figure of 1.75 m at rest: metres, Z up, it faces -Y."""

    heads: dict[str, np.ndarray]
    """(3,) by bone, in any order."""
    parents: dict[str, str]
    roles: dict[str, str]
    """The right bone by role."""

    def renamed(self, names: dict[str, str]) -> ForeignSkeleton:
        """Return the same bones under other names."""
        return ForeignSkeleton(
            {names[b]: head for b, head in self.heads.items()},
            {names[b]: names[p] for b, p in self.parents.items()},
            {role: names[b] for role, b in self.roles.items()},
        )

    def without_names(self, rng: np.random.Generator) -> ForeignSkeleton:
        """Return the same bones, numbered at random."""
        order = rng.permutation(len(self.heads))
        return self.renamed({b: f"bone_{k:03d}" for b, k in zip(self.heads, order, strict=True)})

    def with_swapped_names(self, rng: np.random.Generator) -> ForeignSkeleton:
        """Return the same bones under each other's names."""
        return self.renamed(dict(zip(self.heads, rng.permutation(list(self.heads)).tolist(), strict=True)))

    def shuffled(self, rng: np.random.Generator) -> ForeignSkeleton:
        """Return the same bones in another order."""
        return replace(self, heads={b: self.heads[b] for b in rng.permutation(list(self.heads)).tolist()})

    def placed(self, place: Callable[[np.ndarray], np.ndarray]) -> ForeignSkeleton:
        """Return the same bones at other places."""
        return replace(self, heads={b: place(head) for b, head in self.heads.items()})


class _Drawing:
    """Adds bones one by one."""

    def __init__(self) -> None:
        self.heads: dict[str, np.ndarray] = {}
        self.parents: dict[str, str] = {}
        self.roles: dict[str, str] = {}

    def bone(self, name: str, parent: str, place: tuple[float, float, float], role: str = "") -> str:
        self.heads[name] = np.array(place, float)
        if parent:
            self.parents[name] = parent
        if role:
            self.roles[role] = name
        return name

    def line(self, names: list[str], parent: str, a: np.ndarray, b: np.ndarray, role: str = "") -> str:
        """Add a chain of bones from a on towards b, evenly."""
        for i, name in enumerate(names):
            parent = self.bone(name, parent, a + (b - a) * i / len(names), f"{role}_{i + 1}" if role else "")
        return parent


@dataclass(frozen=True)
class Naming:
    """How a system names and hangs its bones."""

    middle: dict[str, list[str]]  # ``root``, ``pelvis``, ``spine``, ``neck``, ``head``, ``top``: names from below up.
    side: Callable[[str, str], str]  # Name of a part on a side; "" leaves it out.
    before_thigh: str = ""  # Part between pelvis and thigh that has no length.
    twists: tuple[str, ...] = ()  # Parts with a twist bone halfway: a leaf beside the next part.
    inline: tuple[str, ...] = ()  # Parts in two pieces, the second of which carries on.
    extras: tuple[str, ...] = ()  # ``ik``, ``hair``, ``skirt``, ``face``, ``breasts``.
    fingers: int = 3  # Bones of a finger; 0 for none.
    palms: bool = False  # Bones of the palm before the fingers.


def draw(naming: Naming, arms_down_deg: float = 0.0, legs: float = 1.0) -> ForeignSkeleton:
    """Draw a figure by a naming.

    Args:
        naming: of which system.
        arms_down_deg: how far the arms hang below the horizontal.
        legs: length of the legs by a usual figure's.
    """
    d, hip = _Drawing(), 0.92 * legs
    middle = naming.middle
    parent = ""
    for name in middle.get("root", []):
        parent = d.bone(name, parent, (0, 0, 0), "" if parent else "root")
    pelvis = parent = d.bone(middle["pelvis"][0], parent, (0, 0.005, hip + 0.05), "pelvis")
    for name in middle.get("below", []):
        parent = d.bone(name, parent, (0, 0.005, hip + 0.04))
    legs_from, low, high = parent, np.array([0, 0.01, hip + 0.14]), np.array([0, 0.02, hip + 0.56])
    chest = d.line(middle["spine"], pelvis, low, high, "spine")
    neck = d.line(middle["neck"], chest, np.array([0, 0.02, hip + 0.58]), np.array([0, 0.0, hip + 0.67]), "neck")
    head = d.bone(middle["head"][0], neck, (0, 0.0, hip + 0.67), "head")
    for name in middle.get("top", []):
        d.bone(name, head, (0, 0.0, hip + 0.87))
    for side, sign in zip(SIDES, (1.0, -1.0), strict=True):
        _draw_leg(d, naming, side, sign, legs_from, legs)
        _draw_arm(d, naming, side, sign, chest, hip, arms_down_deg)
    _draw_extras(d, naming, middle, pelvis, chest, head, hip)
    return ForeignSkeleton(d.heads, d.parents, d.roles)


def _draw_leg(d: _Drawing, naming: Naming, side: str, sign: float, parent: str, legs: float) -> None:
    hip, knee = np.array([sign * 0.09, 0, 0.92 * legs]), np.array([sign * 0.092, -0.005, 0.49 * legs])
    ankle, ball = np.array([sign * 0.095, 0.02, 0.085]), np.array([sign * 0.105, -0.10, 0.02])
    if naming.before_thigh:
        parent = d.bone(naming.side(naming.before_thigh, side), parent, d.heads[parent])
    for part, start, stop in (("thigh", hip, knee), ("shin", knee, ankle)):
        parent = _draw_part(d, naming, part, side, parent, start, stop)
    foot = d.bone(naming.side("foot", side), parent, ankle, f"{side}_foot")
    if name := naming.side("palm_foot", side):
        foot = d.bone(name, foot, ankle + 0.35 * (ball - ankle))
    if name := naming.side("toe", side):
        toe = d.bone(name, foot, ball, f"{side}_toe")
        if name := naming.side("toe_end", side):
            d.bone(name, toe, ball + [0, -0.07, -0.01])


def _draw_part(d: _Drawing, naming: Naming, part: str, side: str, parent: str, a: np.ndarray, b: np.ndarray) -> str:
    name = d.bone(naming.side(part, side), parent, a, f"{side}_{part}")
    if part in naming.twists:
        d.bone(naming.side(f"{part}_twist", side), name, (a + b) / 2)
    if part in naming.inline:
        return d.bone(naming.side(f"{part}_inline", side), name, (a + b) / 2)
    return name


def _draw_arm(d: _Drawing, naming: Naming, side: str, sign: float, chest: str, hip: float, down: float) -> None:
    shoulder = np.array([sign * 0.18, 0.03, hip + 0.52])
    c, s = np.cos(np.radians(down)), np.sin(np.radians(down))
    along, across, below = np.array([sign * c, 0, -s]), np.array([0.0, 1, 0]), np.array([-sign * s, 0, -c])
    elbow, wrist = shoulder + 0.28 * along + 0.005 * across, shoulder + 0.53 * along
    parent = d.bone(naming.side("clavicle", side), chest, (sign * 0.03, 0.0, hip + 0.54), f"{side}_clavicle")
    for part, start, stop in (("upper_arm", shoulder, elbow), ("forearm", elbow, wrist)):
        parent = _draw_part(d, naming, part, side, parent, start, stop)
    hand = d.bone(naming.side("hand", side), parent, wrist, f"{side}_hand")
    for finger, (far, back) in FINGERS.items():
        base, above = hand, wrist + far * along + back * across
        if not naming.fingers or not naming.side(f"{finger}_1", side):
            continue
        if naming.palms and finger != "thumb":
            base = d.bone(naming.side(f"{finger}_0", side), hand, wrist + 0.25 * far * along + 0.8 * back * across)
        way = along if finger != "thumb" else 0.7 * along - 0.6 * across + 0.4 * below
        for i in range(naming.fingers):
            role = f"{side}_{finger}_{i + 1}" if i < 3 else ""
            base = d.bone(naming.side(f"{finger}_{i + 1}", side), base, above + 0.028 * i * way, role)


def _draw_extras(
    d: _Drawing, naming: Naming, middle: dict[str, list[str]], pelvis: str, chest: str, head: str, hip: float
) -> None:
    root = middle.get("root", [pelvis])[0]
    if "ik" in naming.extras:
        foot_root, hand_root = d.bone("ik_foot_root", root, (0, 0, 0)), d.bone("ik_hand_root", root, (0, 0, 0))
        gun = d.bone("ik_hand_gun", hand_root, tuple(d.heads[d.roles["right_hand"]]))
        for side in SIDES:
            d.bone(f"ik_foot_{side[0]}", foot_root, tuple(d.heads[d.roles[f"{side}_foot"]]))
            d.bone(f"ik_hand_{side[0]}", gun, tuple(d.heads[d.roles[f"{side}_hand"]]))
    for side, sign in zip(SIDES, (1.0, -1.0), strict=True):
        if "face" in naming.extras:
            d.bone(naming.side("eye", side), head, (sign * 0.03, -0.08, hip + 0.75))
        if "breasts" in naming.extras:
            first = d.bone(naming.side("breast_1", side), chest, (sign * 0.06, -0.08, hip + 0.4))
            d.bone(naming.side("breast_2", side), first, (sign * 0.06, -0.14, hip + 0.4))
        if "skirt" in naming.extras:
            a, b = np.array([sign * 0.12, -0.1, hip]), np.array([sign * 0.2, -0.2, hip - 0.4])
            d.line([naming.side(f"skirt_{i}", side) for i in (1, 2, 3)], pelvis, a, b)
        if "hair" in naming.extras:
            a, b = np.array([sign * 0.08, 0.02, hip + 0.85]), np.array([sign * 0.12, 0.12, hip + 0.2])
            d.line([naming.side(f"hair_{i}", side) for i in (1, 2, 3, 4)], head, a, b)
