"""Write poses as JSON for Unreal's Live Link and the free plugin JSONLiveLink.

A packet is an object with one subject, which is a list of bones, parents first. A bone has ``Name``, ``Parent`` (index
of a bone, -1 for the root), ``Location`` in centimetres, ``Rotation`` as a quaternion xyzw and ``Scale``, all relative
to its parent. Axes are Unreal's: left-handed, Z up. A body at rest faces +Y, without bone rotations.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..body_layout import BodyLayout
from ..so3 import matrix_from_rotvec, quat_from_matrix

SUBJECT = "manifold"
_STAND = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Rotates the body's axes (Y up, Z forward) to Z up and -Y forward."""
_CM = 100.0 * np.array([1.0, -1.0, 1.0])  # From right-handed metres to Unreal's centimetres.
_XYZW = np.array([-1.0, 1.0, -1.0, 1.0])  # Signs of a rotation under y -> -y. The axis is a pseudovector.


@dataclass(frozen=True)
class JsonFrames:
    """Builds Live Link packets for a body."""

    layout: BodyLayout
    rest_joints: np.ndarray  # (J, 3) joint positions in metres, Y up, facing +Z, left = +X.

    @cached_property
    def _offsets(self) -> np.ndarray:
        parents = list(self.layout.parents[1:])
        apart = np.concatenate([self.rest_joints[:1], self.rest_joints[1:] - self.rest_joints[parents]])
        return apart @ _STAND.T * _CM

    def encode(self, time_s: float, rotvec: np.ndarray, transl: np.ndarray) -> bytes:
        """Encode a pose as a packet. ``rotvec`` (n, 3) rotates the first n joints. All other joints are at rest."""
        local = np.tile(np.eye(3), (self.layout.num_joints, 1, 1))
        local[: len(rotvec)] = matrix_from_rotvec(rotvec)
        before = np.concatenate([np.eye(3)[None], np.broadcast_to(_STAND, (self.layout.num_joints - 1, 3, 3))])
        quat = np.round(quat_from_matrix(before @ local @ _STAND.T)[:, [1, 2, 3, 0]] * _XYZW, 6)
        places = self._offsets.copy()
        places[0] = (self.rest_joints[0] + transl) * _CM
        rows = zip(self.layout.joints, self.layout.parents, np.round(places, 3).tolist(), quat.tolist(), strict=True)
        bones = [
            {"Name": name, "Parent": parent, "Location": place, "Rotation": turn, "Scale": [1, 1, 1]}
            for name, parent, place, turn in rows
        ]
        return json.dumps({SUBJECT: bones}, separators=(",", ":")).encode()
