"""Pose a live body from incoming poses, or send a body's poses, without actions or keys."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import bpy
import numpy as np

from .._exchange.errors import FileDamaged
from .._exchange.json_file import read_json_file
from .._exchange.so3 import matrix_from_rotvec, rotvec_from_matrix
from .._exchange.vmc.humanoid import Humanoid
from .._exchange.vmc.osc import FrameBundle
from .._exchange.vmc.sender import PacketSender, VmcAddress
from ..animation.action import bone_quaternions, read_pose
from ..animation.curves import current_action
from ..animation.takes import BETAS
from ..body.armature import rotation_from_body_axes
from ..body.body_file import BodyFile, body_path_of, pose_joints, read_body, turns_on
from ..body.rig import create_rig
from ..body.shape import body_mesh, get_betas, set_betas
from ..conventions.coordinates import fit_units
from ..conventions.datablocks import MARKER_COLOURS, child_collection
from ..conventions.skeleton import SMPL, layout_of
from ..conventions.timing import TakeTiming, scene_frame_rate
from .overlay import PointLook, create_point_overlay
from .point_player import GRADE, SEEN

NAME = "Live"
MOST_POINTS = 90
"""Largest number of points. Even the largest marker layout has fewer. Chosen by hand."""
_LOOK, _JOINT_LOOK = PointLook(0.008, MARKER_COLOURS), PointLook(0.018, MARKER_COLOURS)
"""Radii of points and joints in metres, and the colours that show their uncertainty. Chosen by hand."""
_OFF_M = (0.0, 0.03, 0.08)
"""Smallest distances from the body in metres for the second, third and fourth colour of a point. At the last one the
solver reports the pose as uncertain. A point that does not belong to the body keeps the first colour."""
_DOUBT_M = (0.0, 0.02, 0.05)
"""Smallest standard deviations in metres for the second, third and fourth colour of a joint. With cameras and markers
an observed joint typically has 0.02 m, and a joint that has been unobserved for a while has 0.05 m."""
_UNSURE = 2  # Lowest colour number of joints in an unsure pose.


@dataclass
class LiveFigure:
    """A live body. Objects are stored by name, because undo replaces them."""

    armature: str
    mesh: str
    points: str
    joints: str
    body: BodyFile
    betas: np.ndarray
    R_bone_body: np.ndarray

    def reshape(self, betas: np.ndarray) -> bool:
        """Set the body's shape. Return whether the body still exists."""
        mesh = bpy.data.objects.get(self.mesh)
        if mesh is None:
            return False
        self.betas = np.asarray(betas, dtype=np.float64)
        set_betas(mesh, self.betas)
        return True

    def pose(self, rotvec: np.ndarray, transl: np.ndarray) -> bool:
        """Pose the body from axis-angle vectors and a translation. Return whether the body still exists."""
        armature, joints = bpy.data.objects.get(self.armature), self.body.layout.joints
        if armature is None or armature.pose is None or not set(joints) <= set(armature.pose.bones.keys()):
            return False
        quaternions = bone_quaternions(turns_on(self.body.layout, rotvec[None]), self.R_bone_body)[0]
        for joint, quaternion in zip(joints, quaternions.tolist(), strict=True):
            armature.pose.bones[joint].rotation_quaternion = quaternion
        pelvis = armature.pose.bones[joints[0]]
        rest = np.array(pelvis.bone.matrix_local, dtype=np.float64)
        at = self.body.rest_joints(self.betas)[0] + transl - rest[:3, 3]
        pelvis.location = (at @ rest[:3, :3]).tolist()
        return True

    def show_points(self, points: np.ndarray, off_m: np.ndarray | None = None) -> bool:
        """Show (N, 3) points, coloured by their distance from the body. Return whether the point object exists."""
        known = off_m is not None and len(off_m) == len(points)
        off = np.asarray(off_m) if known else np.full(len(points), np.nan)
        return _show(self.points, points[:MOST_POINTS], _grades(off[:MOST_POINTS], _OFF_M))

    def show_doubt(self, rotvec: np.ndarray, transl: np.ndarray, sigma_m: np.ndarray | None, *, unsure: bool) -> bool:
        """Colour a pose's joints by their (24,) standard deviations. Return whether the joint object still exists."""
        if sigma_m is None:
            return _show(self.joints, np.zeros((0, 3)), np.zeros(0))
        layout = self.body.layout
        _, joints = pose_joints(self.body.rest_joints(self.betas), turns_on(layout, rotvec[None]), transl[None])
        grades = np.maximum(_grades(np.nan_to_num(sigma_m, nan=np.inf), _DOUBT_M), _UNSURE if unsure else 0)
        return _show(self.joints, joints[0, list(layout.standing_for(SMPL))], grades)


def _grades(metres: np.ndarray, bounds: tuple[float, ...]) -> np.ndarray:
    return np.digitize(np.where(np.isnan(metres), -1.0, metres), bounds)


def _show(name: str, points: np.ndarray, grades: np.ndarray) -> bool:
    cloud = bpy.data.objects.get(name)
    if cloud is None or cloud.type != "MESH" or len(cloud.data.vertices) != MOST_POINTS:
        return False
    where, count = np.zeros((MOST_POINTS, 3), np.float32), len(points)
    seen, grade = np.zeros(MOST_POINTS, np.float32), np.zeros(MOST_POINTS, np.float32)
    where[:count], seen[:count], grade[:count] = points, 1.0, grades
    cloud.data.vertices.foreach_set("co", where.ravel())
    for attribute, values in ((SEEN, seen), (GRADE, grade)):
        cloud.data.attributes[attribute].data.foreach_set("value", values)
    cloud.data.update_tag()
    return True


def create_live_figure(scene: bpy.types.Scene, body: BodyFile, betas: np.ndarray, *, shown: bool = True) -> LiveFigure:
    """Create the body and the points of a live run in a new collection."""
    _remove_live_figure()
    collection = child_collection(NAME, scene.collection)
    collection["live_figure"] = True
    rig = create_rig(NAME, body, betas, collection)
    for joint in body.layout.joints:
        rig.armature.pose.bones[joint].rotation_mode = "QUATERNION"
    for part in (rig.armature, rig.mesh):
        part.hide_viewport = not shown
    timing = TakeTiming(scene.frame_start, scene_frame_rate(scene))
    nowhere = np.full((1, MOST_POINTS, 3), np.nan)
    points = create_point_overlay(f"{NAME} points", nowhere, 1.0, timing, collection, _LOOK)
    joints = create_point_overlay(f"{NAME} joints", nowhere, 1.0, timing, collection, _JOINT_LOOK)
    fit_units(scene, (rig.armature, points, joints))
    names = rig.armature.name, rig.mesh.name, points.name, joints.name
    return LiveFigure(*names, body, np.asarray(betas, np.float64), rotation_from_body_axes(rig.armature))


def _remove_live_figure() -> None:
    for collection in [c for c in bpy.data.collections if c.name.split(".")[0] == NAME and c.get("live_figure")]:
        for obj in list(collection.objects):
            bpy.data.objects.remove(obj, do_unlink=True)
        bpy.data.collections.remove(collection)


@dataclass
class LiveFace:
    """A mesh with a face that follows incoming values. The mesh is stored by name, because undo replaces objects."""

    mesh: str  # Object name of the mesh.
    table: Mapping[str, str] = field(default_factory=dict)
    """Shape key of each channel, by the channel's name in lower case. Other channels use the key of the same name."""

    def show(self, face: Mapping[str, float]) -> int:
        """Set the mesh's shape keys to the values of the face channels, and return how many were set."""
        obj = bpy.data.objects.get(self.mesh)
        keys = getattr(obj.data, "shape_keys", None) if obj is not None else None
        if keys is None:
            return 0
        blocks = {block.name.lower(): block for block in list(keys.key_blocks)[1:]}
        found = 0
        for channel, value in face.items():
            block = blocks.get(self.table.get(channel.lower(), channel).lower())
            if block is not None:
                block.value = value
                found += 1
        return found


def read_face_table(path: Path) -> dict[str, str]:
    """Read a table that maps channels to shape keys, a JSON object such as ``{"JawOpen": "Mouth Open"}``."""
    values = read_json_file(path)
    if not isinstance(values, dict) or not all(isinstance(key, str) for key in values.values()):
        hint = 'Write an object of channels and shape keys: {"JawOpen": "Mouth Open"}.'
        raise FileDamaged("The file is not a table of face channels.", where=str(path), hint=hint)
    return {channel.lower(): key for channel, key in values.items()}


class TakeSender:
    """Sends a body's poses over VMC. The body is stored by name, because undo replaces objects."""

    def __init__(self, armature: bpy.types.Object, address: VmcAddress) -> None:
        """Store the body's current proportions. Raise ``MocapError`` if the host or the body is unsuitable."""
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
        """Send the pose. Return "" or a message about the receiver, or None if the body no longer exists."""
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
        """Close the network socket."""
        self._packets.close()
