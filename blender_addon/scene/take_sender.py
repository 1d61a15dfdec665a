"""Send the current pose of a body by the VMC protocol, with fingers, edits and constraints."""

from __future__ import annotations

import time

import bpy
import numpy as np

from .._exchange.so3 import matrix_from_rotvec, rotvec_from_matrix
from .._exchange.vmc.humanoid import Humanoid
from .._exchange.vmc.osc import FrameBundle
from .._exchange.vmc.sender import PacketSender, VmcAddress
from ..animation.action import read_pose
from ..animation.curves import current_action
from ..animation.takes import BETAS
from ..body.armature import rotation_from_body_axes
from ..body.body_file import body_path_of, read_body
from ..body.shape import body_mesh, get_betas
from ..conventions.skeleton import layout_of


class TakeSender:
    """Sends the poses of a body, which is looked up each time as undo replaces it."""

    def __init__(self, armature: bpy.types.Object, address: VmcAddress) -> None:
        """Keep the body's present proportions. An unknown host or unreadable body file is a ``MocapError``."""
        action, mesh = current_action(armature), body_mesh(armature)
        kept = action.get(BETAS) if action is not None else None
        betas = get_betas(mesh) if mesh is not None else np.array(np.zeros(10) if kept is None else kept)
        layout = layout_of(armature.data.bones)
        body = read_body(body_path_of("" if action is None else action.get("provenance", "")), layout)
        self._joints, self._rest = body.layout.joints, body.rest_joints(betas)
        self._bundle = FrameBundle(Humanoid(body.layout, self._rest))
        self._R_bone_body = rotation_from_body_axes(armature)
        self._name, self._start = armature.name, time.monotonic()
        self._packets = PacketSender(address)

    def send(self, scene: bpy.types.Scene) -> str | None:
        """Send the pose, and return a message about the receiver, "" for none, or None if the body is gone."""
        armature = scene.objects.get(self._name)
        if armature is None or armature.pose is None or not set(self._joints) <= set(armature.pose.bones.keys()):
            return None
        pose = read_pose(armature, self._rest[0], self._R_bone_body)
        place, turn, _ = armature.matrix_world.decompose()
        R = np.array(turn.to_matrix(), dtype=np.float64)
        rotvec = pose.rotvec.copy()
        rotvec[0] = rotvec_from_matrix(R @ matrix_from_rotvec(rotvec[0]))
        pelvis = R @ (self._rest[0] + pose.transl) + np.array(place) * scene.unit_settings.scale_length
        return self._packets.send(self._bundle.encode(time.monotonic() - self._start, rotvec, pelvis - self._rest[0]))

    def close(self) -> None:
        """Close the socket."""
        self._packets.close()
