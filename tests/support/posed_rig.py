"""A rig posed by rotations in the body's axes, and how far Blender's evaluation of it is from the model."""

from __future__ import annotations

from collections.abc import Callable

import bpy
import numpy as np

from blender_addon._exchange.motion_file import MotionFile
from blender_addon.animation.action import bone_quaternions
from blender_addon.body.armature import rotation_from_body_axes
from blender_addon.body.body_file import BodyFile, pose_joints, skin
from blender_addon.body.rig import Rig
from blender_addon.body.shape import get_betas
from blender_addon.conventions.skeleton import JOINTS

Compare = Callable[[np.ndarray], tuple[float, float]]
"""Poses a rig and returns its largest distances from the model in mm: joints, skin."""


def distances_mm(rig: Rig, body: BodyFile, rotvec: np.ndarray) -> tuple[float, float]:
    """Pose a rig and return the largest distances of joints and skin from the model of the same shape.

    Args:
        rig: the rig; its shape is what its sliders say.
        body: its body.
        rotvec: (24, 3) axis-angle in radians in the body's axes, the root among them.
    """
    pose(rig, rotvec)
    betas = get_betas(rig.mesh)
    pelvis = np.array(rig.armature.data.bones["pelvis"].head_local)
    motion = MotionFile("pose", rotvec[None], pelvis - body.rest_joints(betas)[:1], betas, fps=30.0)
    _, expected = pose_joints(body.rest_joints(betas), motion.rotvec, motion.transl)
    joints, vertices = evaluated(rig)
    largest = [
        np.linalg.norm(a - b, axis=-1).max() for a, b in ((joints, expected[0]), (vertices, skin(body, motion, [0])[0]))
    ]
    return 1e3 * float(largest[0]), 1e3 * float(largest[1])


def pose(rig: Rig, rotvec: np.ndarray) -> None:
    """Turn the posed bones by (24, 3) rotations in the body's axes."""
    quaternions = bone_quaternions(rotvec[None], rotation_from_body_axes(rig.armature))[0]
    for joint, quaternion in zip(JOINTS, quaternions.tolist(), strict=True):
        rig.armature.pose.bones[joint].rotation_quaternion = quaternion


def evaluated(rig: Rig) -> tuple[np.ndarray, np.ndarray]:
    """Return the (24, 3) joints and (V, 3) vertices in the world, as Blender evaluates them."""
    bpy.context.view_layer.update()
    depsgraph = bpy.context.evaluated_depsgraph_get()
    armature, mesh = rig.armature.evaluated_get(depsgraph), rig.mesh.evaluated_get(depsgraph)
    co = np.empty(3 * len(mesh.data.vertices), dtype=np.float32)
    mesh.data.vertices.foreach_get("co", co)
    world = np.array(mesh.matrix_world, dtype=np.float64)
    joints = np.array([armature.matrix_world @ armature.pose.bones[joint].head for joint in JOINTS])
    return joints, co.reshape(-1, 3) @ world[:3, :3].T + world[:3, 3]
