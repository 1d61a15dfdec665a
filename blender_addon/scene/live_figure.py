"""The body and the points of a live run: posed anew at every look, without actions, keys or operators."""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import numpy as np

from ..animation.action import bone_quaternions
from ..body.armature import rotation_from_body_axes
from ..body.body_file import BodyFile
from ..body.rig import create_rig
from ..body.shape import set_betas
from ..conventions.collections import child_collection
from ..conventions.materials import MARKER_COLOURS
from ..conventions.skeleton import JOINTS
from ..conventions.timing import TakeTiming, scene_frame_rate
from ..conventions.units import fit_units
from .overlay import PointLook, create_point_overlay
from .point_player import GRADE, SEEN

NAME = "Live"
MOST_POINTS = 90
"""Points that are shown at most, more than the largest layout of markers has; chosen by hand."""
_LOOK = PointLook(0.008, MARKER_COLOURS)
_OFF_M = (0.0, 0.03, 0.08)
"""Metres from the body from which a point has the second, third and fourth colour: near, off, and far off as the solver
has it, from where a pose is unsure; what is none of the body's has the first."""
"""Radius in metres, and colour; chosen by hand."""


@dataclass
class LiveFigure:
    """Names of the objects, and what posing them needs; the objects are looked up each time, as undo replaces them."""

    armature: str
    mesh: str
    points: str
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
        """Let the body stand in a pose of (24, 3) axis-angles, its pelvis moved by (3,) metres; return whether it can.

        Raises nothing: a body that undo or the user took away is left alone.
        """
        armature = bpy.data.objects.get(self.armature)
        if armature is None or armature.pose is None or any(joint not in armature.pose.bones for joint in JOINTS):
            return False
        quaternions = bone_quaternions(rotvec[None], self.R_bone_body)[0]
        for joint, quaternion in zip(JOINTS, quaternions.tolist(), strict=True):
            armature.pose.bones[joint].rotation_quaternion = quaternion
        pelvis = armature.pose.bones[JOINTS[0]]
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
        cloud = bpy.data.objects.get(self.points)
        if cloud is None or cloud.type != "MESH" or len(cloud.data.vertices) != MOST_POINTS:
            return False
        where = np.zeros((MOST_POINTS, 3), np.float32)
        seen = np.zeros(MOST_POINTS, np.float32)
        count = min(len(points), MOST_POINTS)
        where[:count], seen[:count] = points[:count], 1.0
        cloud.data.vertices.foreach_set("co", where.ravel())
        cloud.data.attributes[SEEN].data.foreach_set("value", seen)
        if off_m is not None and len(off_m) == len(points):
            grade = np.zeros(MOST_POINTS, np.float32)
            grade[:count] = np.digitize(np.nan_to_num(off_m[:count], nan=-1.0), _OFF_M)
            cloud.data.attributes[GRADE].data.foreach_set("value", grade)
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
    for joint in JOINTS:
        rig.armature.pose.bones[joint].rotation_mode = "QUATERNION"
    for part in (rig.armature, rig.mesh):
        part.hide_viewport = not shown
    rig.armature.show_in_front = True  # bones have the colours of their joints' doubt
    rig.armature.data.display_type = "STICK"
    timing = TakeTiming(scene.frame_start, scene_frame_rate(scene))
    nowhere = np.full((1, MOST_POINTS, 3), np.nan)
    points = create_point_overlay(f"{NAME} points", nowhere, 1.0, timing, collection, _LOOK)
    fit_units(scene, (rig.armature, points))
    return LiveFigure(
        rig.armature.name, rig.mesh.name, points.name, body, np.asarray(betas, dtype=np.float64),
        rotation_from_body_axes(rig.armature),
    )  # fmt: skip


def remove_live_figure() -> None:
    """Take away what earlier runs have shown."""
    for collection in [c for c in bpy.data.collections if c.name.split(".")[0] == NAME and c.get("live_figure")]:
        for obj in list(collection.objects):
            bpy.data.objects.remove(obj, do_unlink=True)
        bpy.data.collections.remove(collection)
