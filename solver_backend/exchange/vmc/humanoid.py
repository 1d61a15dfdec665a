"""Convert poses of our bodies to Unity's humanoid bones and back."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..body_layout import BodyLayout
from ..errors import MotionInvalid
from ..plain_text import pairs
from ..so3 import quat_from_rotvec, quat_multiply, rotvec_from_quat

_FINGERS = {"thumb": "Thumb", "index": "Index", "middle": "Middle", "ring": "Ring", "pinky": "Little"}
_KNUCKLES = ("Proximal", "Intermediate", "Distal")
_OF_A_SIDE = {
    **pairs("eye Eye hip UpperLeg knee LowerLeg ankle Foot foot Toes"),
    **pairs("collar Shoulder shoulder UpperArm elbow LowerArm wrist Hand"),
    **{f"{ours}{k + 1}": f"{unity}{part}" for ours, unity in _FINGERS.items() for k, part in enumerate(_KNUCKLES)},
}
BONE_OF = {
    **pairs("pelvis Hips spine1 Spine spine2 Chest spine3 UpperChest neck Neck head Head jaw Jaw"),
    **{f"{s}_{joint}": f"{s.capitalize()}{bone}" for joint, bone in _OF_A_SIDE.items() for s in ("left", "right")},
}
"""Unity bone for each joint in the SMPL family. SMPL's hand joints, the knuckles of flat hands, have none."""
JOINT_OF = {bone: joint for joint, bone in BONE_OF.items()}


_ARM = ("shoulder", "elbow", "wrist")
_LEG = ("hip", "knee")
_FOOT = ("ankle", "foot")
_HANDS = ("left_hand", "right_hand")


def t_pose(layout: BodyLayout, rest_joints: np.ndarray) -> np.ndarray:
    """Return the rotations from rest pose to T-pose in the body's axes, (J, 4) wxyz.

    Arms and fingers point along ±X, legs along -Y, and thumbs halfway between ±X and +Z (VRM 1.0, T-pose). Each bone
    takes the smallest rotation to its direction. Finger bones first take their parent's rotation. Feet only rotate
    about Y until they point along +Z, so that the soles stay flat. Hips, spine, neck, head and shoulders do not rotate,
    because their bend at rest belongs to the character.

    Args:
        rest_joints: (J, 3) joint positions in metres, Y up, facing +Z, left = +X.
    """
    turns = np.tile([1.0, 0.0, 0.0, 0.0], (layout.num_joints, 1))
    for j, name in enumerate(layout.joints):
        side, _, part = name.partition("_")
        along = _bone(layout, rest_joints, j)
        if part in _ARM and along is not None:
            turns[j] = _shortest(along, np.array([1.0 if side == "left" else -1.0, 0.0, 0.0]))
        elif part in _LEG and along is not None:
            turns[j] = _shortest(along, np.array([0.0, -1.0, 0.0]))
        elif part == _FOOT[0] and along is not None:
            turns[j] = _shortest(along * (1.0, 0.0, 1.0), np.array([0.0, 0.0, 1.0]))
        elif part == _FOOT[1] or layout.groups[j] in _HANDS:
            turns[j] = turns[layout.parents[j]]
            if layout.groups[j] in _HANDS and along is not None:
                flat = np.array([1.0 if side == "left" else -1.0, 0.0, float(part.startswith("thumb"))])
                turns[j] = quat_multiply(_shortest(turned(turns[j], along), flat), turns[j])
    return turns


def _bone(layout: BodyLayout, rest_joints: np.ndarray, j: int) -> np.ndarray | None:
    """Return a bone's direction (from the wrist: towards the middle knuckle), or None at the end of a chain."""
    children = layout.children[j]
    knuckles = [c for c in children if "middle" in layout.joints[c] or layout.joints[c].endswith("_hand")]
    end = layout.main_child.get(j, (knuckles or [None])[0])
    if end is None:
        return None
    along = rest_joints[end] - rest_joints[j]
    return along if np.linalg.norm(along) > 1e-6 else None


def _shortest(source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Return the smallest rotation from one direction to another, ``(1 + a·b, a × b)`` normalised."""
    source, target = source / np.linalg.norm(source), target / np.linalg.norm(target)
    turn = np.concatenate([[1.0 + source @ target], np.cross(source, target)])
    length = np.linalg.norm(turn)
    # Opposite directions have no smallest rotation, but no body rests with an arm through its chest.
    return turn / length if length > 1e-6 else np.array([1.0, 0.0, 0.0, 0.0])


def unturned(quat: np.ndarray) -> np.ndarray:
    """Invert unit quaternions wxyz."""
    return quat * (1.0, -1.0, -1.0, -1.0)


def turned(quat: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Rotate (..., 3) vectors by (..., 4) unit quaternions wxyz."""
    pure = np.concatenate([np.zeros((*vectors.shape[:-1], 1)), vectors], axis=-1)
    return quat_multiply(quat_multiply(quat, pure), unturned(quat))[..., 1:]


_Y_UP = np.array([0.5**0.5, -(0.5**0.5), 0.0, 0.0])  # Rotates our world (Z up) to Y up: -90° about X.
_MIRROR_QUAT = np.array([1.0, 1.0, -1.0, -1.0])  # Signs of rotations wxyz under x -> -x. The axis is a pseudovector.
_MIRROR = np.array([-1.0, 1.0, 1.0])
"""From right-handed axes with left = +X to Unity's left-handed axes with right = +X. Both have Y up and face +Z."""


@dataclass(frozen=True)
class Humanoid:
    """A body shape as a Unity humanoid. Its bones have no rotation in the T-pose.

    If L_j is the rotation of joint j relative to its parent p, and T are the rotations from rest to T-pose, the
    protocol uses ``N_j = T_p L_j T_j⁻¹``.
    """

    layout: BodyLayout
    rest_joints: np.ndarray  # (J, 3) joint positions in metres, Y up, facing +Z, left = +X.

    def __post_init__(self) -> None:
        unnamed = [self.layout.joints[p] for p in self._parents if self.layout.joints[p] not in BONE_OF]
        if self.layout.joints[0] not in BONE_OF or unnamed:
            raise MotionInvalid(
                f"The layout {self.layout.name} has joints that are not bones of a humanoid: "
                f"{', '.join(unnamed or self.layout.joints[:1])}.",
                hint="Send a motion of an SMPL-type body.",
            )

    @cached_property
    def joints(self) -> np.ndarray:
        """(B,) indices of the joints that have a Unity bone, root first."""
        return np.array([j for j, name in enumerate(self.layout.joints) if name in BONE_OF])

    @cached_property
    def bones(self) -> tuple[str, ...]:
        """Unity's names for the B bones."""
        return tuple(BONE_OF[self.layout.joints[j]] for j in self.joints)

    @cached_property
    def _parents(self) -> list[int]:
        return [self.layout.parents[j] for j in self.joints[1:]]

    @cached_property
    def _turns(self) -> np.ndarray:
        return t_pose(self.layout, self.rest_joints)

    @cached_property
    def offsets(self) -> np.ndarray:
        """(B, 3) offset of each bone from its parent in the T-pose, in metres and Unity's axes."""
        offsets = np.zeros((len(self.joints), 3))
        apart = self.rest_joints[self.joints[1:]] - self.rest_joints[self._parents]
        offsets[1:] = turned(self._turns[self._parents], apart) * _MIRROR
        return offsets

    def to_unity(self, rotvec: np.ndarray, transl: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Convert a pose to bones in Unity's world, which shares our origin and floor.

        Args:
            rotvec: (n, 3) rotation vectors of the first n joints. The root's vector rotates the body to the world. The
                remaining joints are at rest.
            transl: (3,) translation in metres, Z up. The pelvis is at ``J_0 + transl``.

        Returns:
            (B, 4) unit quaternions wxyz relative to the parent bone, and the (3,) position of the hips in metres.
        """
        local = np.tile([1.0, 0.0, 0.0, 0.0], (self.layout.num_joints, 1))
        local[: len(rotvec)] = quat_from_rotvec(np.asarray(rotvec, np.float64))
        before = np.concatenate([_Y_UP[None], self._turns[self._parents]])
        normal = quat_multiply(quat_multiply(before, local[self.joints]), unturned(self._turns[self.joints]))
        x, y, z = self.rest_joints[0] + transl
        return normal * _MIRROR_QUAT, np.array([x, z, -y]) * _MIRROR

    def from_unity(self, quat: np.ndarray, hips: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Convert Unity bones to (J, 3) rotation vectors and a translation (3,). This inverts ``to_unity``."""
        after = unturned(np.concatenate([_Y_UP[None], self._turns[self._parents]]))
        local = quat_multiply(quat_multiply(after, quat * _MIRROR_QUAT), self._turns[self.joints])
        rotvec = np.zeros((self.layout.num_joints, 3))
        rotvec[self.joints] = rotvec_from_quat(local)
        x, y, z = np.asarray(hips) * _MIRROR
        return rotvec, np.array([x, -z, y]) - self.rest_joints[0]
