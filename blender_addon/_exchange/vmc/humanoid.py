"""Poses of our bodies as Unity's humanoid bones, and back."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..body_layout import BodyLayout
from ..errors import MotionInvalid
from ..so3 import quat_from_rotvec, quat_multiply, rotvec_from_quat
from .bones import BONE_OF
from .t_pose import t_pose, turned, unturned

_Y_UP = np.array([0.5**0.5, -(0.5**0.5), 0.0, 0.0])
"""Turns our world, Z up, until Y is up: -90° about X."""
_MIRROR_QUAT = np.array([1.0, 1.0, -1.0, -1.0])
"""Rotations wxyz under x -> -x: the axis is a pseudovector."""
_MIRROR = np.array([-1.0, 1.0, 1.0])
"""Right-handed axes with left = +X to Unity's left-handed ones with right = +X; both Y up and facing +Z."""


@dataclass(frozen=True)
class Humanoid:
    """A body of a shape as Unity's humanoid, whose bones do not turn in the T-pose.

    With L_j the rotation of joint j relative to its parent p, and T the turns from rest to the T-pose,
    ``N_j = T_p L_j T_j⁻¹`` is the rotation that the protocol has.
    """

    layout: BodyLayout
    rest_joints: np.ndarray
    """(J, 3) metres, Y up, facing +Z, left = +X."""

    def __post_init__(self) -> None:
        unnamed = [self.layout.joints[p] for p in self._parents if self.layout.joints[p] not in BONE_OF]
        if self.layout.joints[0] not in BONE_OF or unnamed:
            raise MotionInvalid(
                f"The layout {self.layout.name} has joints that are not bones of a humanoid: "
                f"{', '.join(unnamed or self.layout.joints[:1])}.",
                hint="Send a motion of a body of the SMPL family.",
            )

    @cached_property
    def joints(self) -> np.ndarray:
        """(B,) the joints that have a bone, the root first."""
        return np.array([j for j, name in enumerate(self.layout.joints) if name in BONE_OF])

    @cached_property
    def bones(self) -> tuple[str, ...]:
        """Unity's names of the B bones."""
        return tuple(BONE_OF[self.layout.joints[j]] for j in self.joints)

    @cached_property
    def _parents(self) -> list[int]:
        return [self.layout.parents[j] for j in self.joints[1:]]

    @cached_property
    def _turns(self) -> np.ndarray:
        return t_pose(self.layout, self.rest_joints)

    @cached_property
    def offsets(self) -> np.ndarray:
        """(B, 3) metres in Unity's axes: each bone from its parent in the T-pose; zeros for the root."""
        offsets = np.zeros((len(self.joints), 3))
        apart = self.rest_joints[self.joints[1:]] - self.rest_joints[self._parents]
        offsets[1:] = turned(self._turns[self._parents], apart) * _MIRROR
        return offsets

    def to_unity(self, rotvec: np.ndarray, transl: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the bones of a pose in Unity's world, whose origin and floor are ours.

        Args:
            rotvec: (n, 3) axis-angles of the first n joints, the root's body to world; the others are at rest.
            transl: (3,) metres: the pelvis is at ``J_0 + transl``, Z up.

        Returns:
            (B, 4) quaternions wxyz relative to the parent bone, of length 1, and the (3,) metres of the hips.
        """
        local = np.tile([1.0, 0.0, 0.0, 0.0], (self.layout.num_joints, 1))
        local[: len(rotvec)] = quat_from_rotvec(np.asarray(rotvec, np.float64))
        before = np.concatenate([_Y_UP[None], self._turns[self._parents]])
        normal = quat_multiply(quat_multiply(before, local[self.joints]), unturned(self._turns[self.joints]))
        x, y, z = self.rest_joints[0] + transl
        return normal * _MIRROR_QUAT, np.array([x, z, -y]) * _MIRROR

    def from_unity(self, quat: np.ndarray, hips: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return (J, 3) axis-angles and (3,) transl of bones as ``to_unity`` makes them; what has no bone is at rest.

        Args:
            quat: (B, 4) unit quaternions wxyz relative to the parent bone.
            hips: (3,) metres in Unity's world.
        """
        after = unturned(np.concatenate([_Y_UP[None], self._turns[self._parents]]))
        local = quat_multiply(quat_multiply(after, quat * _MIRROR_QUAT), self._turns[self.joints])
        rotvec = np.zeros((self.layout.num_joints, 3))
        rotvec[self.joints] = rotvec_from_quat(local)
        x, y, z = np.asarray(hips) * _MIRROR
        return rotvec, np.array([x, -z, y]) - self.rest_joints[0]
