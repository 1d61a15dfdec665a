"""Describe the joints, tree, sides and groups of bodies, and define the SMPL family's layouts."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

from .errors import BodyInvalid, MotionInvalid

if TYPE_CHECKING:
    import numpy as np

_X, _Y = 0, 1


@dataclass(frozen=True)
class JointLimit:
    """A joint's range of motion."""

    twist: int  # Index of the twist axis.
    low_deg: tuple[float, float, float]  # Smallest angle about x, y and z in degrees.
    high_deg: tuple[float, float, float]

    @property
    def mirrored(self) -> JointLimit:
        """The limit of the corresponding joint on the other side."""
        (low_x, low_y, low_z), (high_x, high_y, high_z) = self.low_deg, self.high_deg
        return JointLimit(self.twist, (low_x, -high_y, -high_z), (high_x, -low_y, -low_z))


ADULTS: dict[str, tuple[int, tuple[tuple[float, float], tuple[float, float], tuple[float, float]]]] = {
    "hip": (_Y, ((-125, 30), (-50, 50), (-30, 60))),
    "knee": (_Y, ((-5, 145), (-35, 35), (-10, 10))),
    "ankle": (_Y, ((-30, 50), (-30, 30), (-30, 30))),
    "foot": (_Y, ((-70, 40), (-15, 15), (-15, 15))),
    "spine1": (_Y, ((-25, 60), (-20, 20), (-25, 25))),
    "spine2": (_Y, ((-25, 40), (-25, 25), (-25, 25))),
    "spine3": (_Y, ((-20, 30), (-30, 30), (-20, 20))),
    "neck": (_Y, ((-40, 40), (-50, 50), (-30, 30))),
    "head": (_Y, ((-60, 40), (-50, 50), (-30, 30))),
    "collar": (_X, ((-20, 30), (-25, 25), (-15, 40))),
    "shoulder": (_X, ((-100, 100), (-140, 60), (-105, 105))),
    "elbow": (_X, ((-90, 90), (-150, 5), (-15, 150))),
    "wrist": (_X, ((-45, 45), (-40, 35), (-80, 80))),
}
"""Range of motion of adult joints: twist axis, and smallest and largest angle in degrees about x, y and z. Values of
paired joints are for the left side. Single joints are from Norkin and White 2016 (after AAOS and Boone and Azen 1979).
The spine's 130 degrees of flexion, 70 of extension, 70 to each side and 75 of rotation are split between three joints,
the neck's between two, and the forearm's between elbow and wrist. The elbow bends forwards or upwards, because T-poses
differ in arm roll."""


def limits_of(joints: tuple[str, ...]) -> dict[str, JointLimit]:
    """Return each joint's adult range of motion by name. Joints that are not in ``ADULTS`` are omitted."""
    found = {}
    for joint in joints:
        part = joint.removeprefix("left_").removeprefix("right_")
        if part in ADULTS:
            axis, ranges = ADULTS[part]
            low, high = zip(*ranges, strict=True)
            limit = JointLimit(axis, low, high)
            found[joint] = limit.mirrored if joint.startswith("right_") else limit
    return found


SMPL_FINGERS = ("index", "middle", "pinky", "ring", "thumb")
"""Fingers in SMPL-H's order. Each has three joints, from the palm outwards. The thumb's first joint is at the wrist."""


@dataclass(frozen=True)
class BodyLayout:
    """The joints of a body, root first, parents before children."""

    name: str
    joints: tuple[str, ...]
    """Joint names. The names for the two sides differ only in ``left_`` and ``right_``."""
    parents: tuple[int, ...]  # Index of each joint's parent, -1 for the root.
    groups: tuple[str, ...]  # Group of each joint, such as trunk, left_arm or left_hand.
    resting: tuple[str, ...] = ()  # Groups whose joints come last and stay at rest during a solve.
    recorded_as: BodyLayout | None = None  # Layout in which motions of such bodies are stored, or None for this layout.
    limits: Mapping[str, JointLimit] = field(default_factory=dict, compare=False)
    """Range of motion by joint name. All other joints rotate freely. Motion files do not store limits."""

    def __post_init__(self) -> None:
        count = len(self.joints)
        if not count == len(self.parents) == len(self.groups) or len(set(self.joints)) < count:
            what = (
                f"{count} joints with {len(self.parents)} parents and {len(self.groups)} groups are not a valid layout."
            )
            raise BodyInvalid(what, where=self.name, hint="Give each joint a unique name, a parent and a group.")
        if any(not -1 <= p < j for j, p in enumerate(self.parents)) or self.parents.count(-1) != 1:
            what = "a single root (-1) is expected, and parents must precede their children"
            raise BodyInvalid(f"Parents {self.parents} are not a tree: {what}.", where=self.name)

    @property
    def num_joints(self) -> int:
        """Number of joints J, including the root."""
        return len(self.joints)

    @cached_property
    def solved(self) -> tuple[str, ...]:
        """Names of the joints that the solver rotates, without the root."""
        moving = [group not in self.resting for group in self.groups]
        return self.joints[1 : moving.index(False) if False in moving else None]

    @property
    def num_solved(self) -> int:
        """Number of joints after the root that the solver rotates."""
        return len(self.solved)

    @property
    def recorded(self) -> BodyLayout:
        """Layout that motion files use for this body."""
        return self.recorded_as or self

    @cached_property
    def mirror(self) -> tuple[int, ...]:
        """Index of the corresponding joint on the other side, or of the joint itself if there is none."""
        sides = {"left": "right", "right": "left"}
        other = [(sides.get(side, side), mark, part) for side, mark, part in (n.partition("_") for n in self.joints)]
        names = map("".join, other)
        return tuple(self.joints.index(name) if name in self.joints else j for j, name in enumerate(names))

    @cached_property
    def children(self) -> tuple[tuple[int, ...], ...]:
        """Indices of each joint's children."""
        return tuple(tuple(c for c, p in enumerate(self.parents) if p == j) for j in range(self.num_joints))

    @cached_property
    def main_child(self) -> dict[int, int]:
        """Index of the child at the end of each joint's bone.

        This is the joint's only child, or the only child in the same group. Joints without such a child are omitted.
        """
        ends = {}
        for j, children in enumerate(self.children):
            own = [c for c in children if self.groups[c] == self.groups[j]]
            if len(children) == 1 or len(own) == 1:
                ends[j] = (own or children)[0]
        return ends

    def numbers(self, *joints: str) -> tuple[int, ...]:
        """Return the indices of the named joints. Raise ``BodyInvalid`` if one is missing."""
        if missing := [name for name in joints if name not in self.joints]:
            raise BodyInvalid(f"{self.name} has no {', '.join(missing)}.", where=self.name)
        return tuple(self.joints.index(name) for name in joints)

    def both(self, *parts: str) -> tuple[int, ...]:
        """Return the indices of the left and right joints of each part, such as hip."""
        return self.numbers(*(f"{side}_{part}" for part in parts for side in ("left", "right")))

    def group(self, name: str) -> tuple[int, ...]:
        """Return the indices of the joints in a group, such as left_arm."""
        return tuple(j for j, group in enumerate(self.groups) if group == name)

    def standing_for(self, other: BodyLayout) -> tuple[int, ...]:
        """Return, for each joint of another layout, the index of the corresponding joint in this layout.

        The first joints of the middle fingers correspond to SMPL's hand joints.

        Raises:
            BodyInvalid: a joint has no counterpart.
        """
        names = [name if name in self.joints else _STAND_INS.get(name, name) for name in other.joints]
        missing = [name for name in names if name not in self.joints]
        if missing:
            raise BodyInvalid(f"{self.name} has no {', '.join(missing)}, which {other.name} has.", where=self.name)
        return tuple(self.joints.index(name) for name in names)

    def shared_with(self, other: BodyLayout) -> tuple[list[int], list[int]]:
        """Return the indices of the joints that both layouts have: first in this layout, then in the other layout."""
        both = [name for name in self.joints if name in other.joints]
        return [self.joints.index(name) for name in both], [other.joints.index(name) for name in both]

    def require_same_joints(self, other: BodyLayout, where: str) -> None:
        """Raise ``MotionInvalid`` unless both layouts have the same joints and parents."""
        if (self.joints, self.parents) != (other.joints, other.parents):
            found = f"The motion has the layout {self.name} ({self.num_joints} joints)"
            what = f"{found}, but {other.name} ({other.num_joints} joints) is expected."
            raise MotionInvalid(what, where=where, hint="Use the body that it was solved with.")

    def without(self, joints: Collection[str], name: str) -> BodyLayout:
        """Return the layout without the given joints and their descendants."""
        kept: list[int] = []
        for j, (joint, parent) in enumerate(zip(self.joints, self.parents, strict=True)):
            kept += [j] if joint not in joints and (parent < 0 or parent in kept) else []
        names, groups = (tuple(texts[j] for j in kept) for texts in (self.joints, self.groups))
        parents = tuple(kept.index(self.parents[j]) if self.parents[j] >= 0 else -1 for j in kept)
        limits = {joint: limit for joint, limit in self.limits.items() if joint in names}
        return replace(self, name=name, joints=names, groups=groups, parents=parents, recorded_as=None, limits=limits)


def _hand(side: str) -> tuple[str, ...]:
    return tuple(f"{side}_{finger}{knuckle}" for finger in SMPL_FINGERS for knuckle in (1, 2, 3))


def _with_fingers(name: str, face: tuple[str, ...]) -> BodyLayout:
    """Add face joints to SMPL's layout, and replace each hand joint with fifteen finger joints."""
    body = SMPL.without(("left_hand", "right_hand"), name)
    joints, parents, groups = [*body.joints, *face], [*body.parents], [*body.groups]
    parents += [joints.index("head")] * len(face)
    groups += ["face"] * len(face)
    for side in ("left", "right"):
        for joint in _hand(side):
            first = joint.endswith("1")
            parents.append(joints.index(f"{side}_wrist") if first else len(joints) - 1)
            joints.append(joint)
            groups.append(f"{side}_hand")
    resting = ("face", "left_hand", "right_hand")
    return BodyLayout(name, tuple(joints), tuple(parents), tuple(groups), resting, SMPL, body.limits)


_STAND_INS = {"left_hand": "left_middle1", "right_hand": "right_middle1"}
"""Joints of SMPL-H and SMPL-X that replace SMPL's hand joints: the first joints of the middle fingers."""

_GROUPS = {**dict.fromkeys(("hip", "knee", "ankle", "foot"), "leg"), "hand": "hand"}
_GROUPS |= dict.fromkeys(("collar", "shoulder", "elbow", "wrist"), "arm")


_SMPL_JOINTS = (
    "pelvis left_hip right_hip spine1 left_knee right_knee spine2 left_ankle right_ankle spine3 left_foot right_foot "
    "neck left_collar right_collar head left_shoulder right_shoulder left_elbow right_elbow left_wrist right_wrist "
    "left_hand right_hand"
)


def _smpl() -> BodyLayout:
    joints = tuple(_SMPL_JOINTS.split())
    parents = (-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21)
    sides = [joint.rpartition("_") for joint in joints]
    groups = tuple(f"{side}_{_GROUPS[part]}" if side else "trunk" for side, _, part in sides)
    return BodyLayout("SMPL", joints, parents, groups, ("left_hand", "right_hand"), limits=limits_of(joints[1:-2]))


SMPL = _smpl()  # SMPL's joints in SMPL's order (Loper et al. 2015).
SMPL_H = _with_fingers("SMPL-H", ())  # SMPL with fingers (Romero et al. 2017).
SMPL_X = _with_fingers("SMPL-X", ("jaw", "left_eye", "right_eye"))
"""SMPL with fingers, jaw and eyes (Pavlakos et al. 2019)."""
SMPL_HANDS = replace(SMPL_H, name="SMPL with hands", resting=(), recorded_as=None)
"""SMPL-H's joints, including moving fingers. The solver rotates all of them, and motions store all of them."""
FAMILY: dict[int, BodyLayout] = {layout.num_joints: layout for layout in (SMPL, SMPL_H, SMPL_X)}
"""Layouts of the SMPL family by number of joints, which identifies the layout of a file."""


AMASS_POSE_WIDTH = 156  # SMPL-H: root, 21 body joints, 2 x 15 finger joints, with 3 numbers each (Mahmood et al. 2019).
AMASS_WIDTHS = (AMASS_POSE_WIDTH, 165)  # SMPL-H, and SMPL-X with jaw and eyes before the fingers.
BODY_COLUMNS = 3 + 3 * SMPL.num_solved  # Number of leading columns, for the root and body joints.
FINGER_COLUMNS = 90  # Number of trailing columns, for the fingers.


def body_and_fingers(poses: np.ndarray) -> np.ndarray:
    """Convert AMASS ``poses`` to (F, 52, 3) rotation vectors, without jaw and eyes."""
    import numpy as np  # not yet imported when Blender registers add-ons

    chosen = np.concatenate([poses[:, :BODY_COLUMNS], poses[:, -FINGER_COLUMNS:]], axis=1)
    return chosen.reshape(len(poses), -1, 3)
