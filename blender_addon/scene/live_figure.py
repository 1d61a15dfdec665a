"""The body and the points of a live run: posed anew at every look, without actions, keys or operators."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import bpy
import numpy as np

from .._exchange.errors import FileDamaged
from .._exchange.json_file import read_json_file
from ..animation.action import bone_quaternions
from ..body.armature import rotation_from_body_axes
from ..body.body_file import BodyFile
from ..body.posed_body import pose_joints, turns_on
from ..body.rig import create_rig
from ..body.shape import set_betas
from ..conventions.coordinates import fit_units
from ..conventions.datablocks import MARKER_COLOURS, child_collection
from ..conventions.skeleton import SMPL
from ..conventions.timing import TakeTiming, scene_frame_rate
from .overlay import PointLook, create_point_overlay
from .point_player import GRADE, SEEN

NAME = "Live"
MOST_POINTS = 90
"""Points that are shown at most, more than the largest layout of markers has; chosen by hand."""
_LOOK, _JOINT_LOOK = PointLook(0.008, MARKER_COLOURS), PointLook(0.018, MARKER_COLOURS)
"""Radii in metres of points and joints, and the colours of their doubt; chosen by hand."""
_OFF_M = (0.0, 0.03, 0.08)
"""Metres from the body from which a point has the second, third and fourth colour: near, off, and far off as the solver
has it, from where a pose is unsure; what is none of the body's has the first."""
_DOUBT_M = (0.0, 0.02, 0.05)
"""Standard deviation from which a joint has the second, third and fourth colour; two centimetres are what cameras and
markers leave of a joint that is seen, five what is left of one that is not, after a while."""
_UNSURE = 2
"""Colour that joints have at least where the pose as a whole is unsure."""


@dataclass
class LiveFigure:
    """Names of the objects, and what posing them needs; the objects are looked up each time, as undo replaces them."""

    armature: str
    mesh: str
    points: str
    joints: str
    body: BodyFile
    betas: np.ndarray
    R_bone_body: np.ndarray

    def reshape(self, betas: np.ndarray) -> bool:
        """Give the body a shape; return whether it is still there."""
        mesh = bpy.data.objects.get(self.mesh)
        if mesh is None:
            return False
        self.betas = np.asarray(betas, dtype=np.float64)
        set_betas(mesh, self.betas)
        return True

    def pose(self, rotvec: np.ndarray, transl: np.ndarray) -> bool:
        """Let the body stand in a pose of (24 or 52, 3) axis-angles, its pelvis moved by (3,) metres.

        Returns whether it can: a body that undo or the user took away is left alone.
        """
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
        """Show points, the first ``MOST_POINTS`` of them; return whether their object is there.

        Args:
            points: (N, 3) metres.
            off_m: (N,) metres between each of them and the body, which colours them; NaN where it is none of its.
        """
        known = off_m is not None and len(off_m) == len(points)
        off = np.asarray(off_m) if known else np.full(len(points), np.nan)
        return _show(self.points, points[:MOST_POINTS], _grades(off[:MOST_POINTS], _OFF_M))

    def show_doubt(
        self, rotvec: np.ndarray, transl: np.ndarray, sigma_m: np.ndarray | None, *, unsure: bool
    ) -> bool:  # fmt: skip
        """Show the joints of a pose in the colours of their doubt; return whether their object is there.

        Args:
            rotvec: (24 or 52, 3) axis-angles.
            transl: (3,) metres.
            sigma_m: (24,) standard deviation of each joint in metres, NaN where nothing is known; None shows none.
            unsure: whether the pose as a whole is.
        """
        if sigma_m is None:
            return _show(self.joints, np.zeros((0, 3)), np.zeros(0))
        layout = self.body.layout
        _, joints = pose_joints(self.body.rest_joints(self.betas), turns_on(layout, rotvec[None]), transl[None])
        grades = _grades(np.nan_to_num(sigma_m, nan=np.inf), _DOUBT_M)
        return _show(
            self.joints, joints[0, list(layout.standing_for(SMPL))], np.maximum(grades, _UNSURE) if unsure else grades
        )


def _grades(metres: np.ndarray, bounds: tuple[float, ...]) -> np.ndarray:
    """Return the colour's number of each distance or deviation; 0 where there is none."""
    return np.digitize(np.where(np.isnan(metres), -1.0, metres), bounds)


def _show(name: str, points: np.ndarray, grades: np.ndarray) -> bool:
    """Show (N, 3) points in their colours by an overlay of ``MOST_POINTS``; return whether it is there."""
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


def create_live_figure(
    scene: bpy.types.Scene, body: BodyFile, betas: np.ndarray, *, shown: bool = True
) -> LiveFigure:  # fmt: skip
    """Create the body and the points of a live run in a collection of their own; an earlier run's are replaced.

    A body that is not shown is there all the same, for the person who comes after the wand.

    Blender must be in object mode, and the scene the window's current one.
    """
    remove_live_figure()
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
    return LiveFigure(
        rig.armature.name, rig.mesh.name, points.name, joints.name, body, np.asarray(betas, dtype=np.float64),
        rotation_from_body_axes(rig.armature),
    )  # fmt: skip


def remove_live_figure() -> None:
    """Take away what earlier runs have shown."""
    for collection in [c for c in bpy.data.collections if c.name.split(".")[0] == NAME and c.get("live_figure")]:
        for obj in list(collection.objects):
            bpy.data.objects.remove(obj, do_unlink=True)
        bpy.data.collections.remove(collection)


@dataclass
class LiveFace:
    """A mesh, looked up each time, as undo replaces it."""

    mesh: str
    """Name of the object."""
    table: Mapping[str, str] = field(default_factory=dict)
    """Shape key of each channel, by the channel's name in lower case; others have the names of their channels."""

    def show(self, face: Mapping[str, float]) -> int:
        """Set the shape keys of channels, within the limits of their sliders; return how many there are.

        Case does not matter. Channels without a shape key change nothing, and neither does a mesh that is gone.
        """
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
    """Return a table of channels: a JSON object such as ``{"JawOpen": "Mouth Open"}``.

    Raises:
        FileMissing, FileDamaged: it cannot be read, or is none.
    """
    values = read_json_file(path)
    if not isinstance(values, dict) or not all(isinstance(key, str) for key in values.values()):
        raise FileDamaged(
            "This is not a table of a face.", where=str(path),
            hint='Write an object of channels and shape keys: {"JawOpen": "Mouth Open"}.',
        )  # fmt: skip
    return {channel.lower(): key for channel, key in values.items()}
