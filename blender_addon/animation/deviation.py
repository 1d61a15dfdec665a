"""Compare the body that Blender evaluates with the same body computed by NumPy."""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import numpy as np

from .._exchange.motion_file import MotionFile
from ..body.body_file import BodyFile, pose_joints, rotvec_on, skin
from ..body.mesh import positions
from ..conventions.skeleton import layout_of
from ..conventions.timing import TakeTiming, go_to_frame


@dataclass(frozen=True)
class Deviation:
    """Largest distances between Blender's posed body and the expected body, over several frames."""

    joints_mm: float  # Distance of pose bone heads from the motion's joint positions, or from those of its pose.
    skin_mm: float  # Distance of the evaluated mesh from the model's skin, with its shape and pose correctives.


def evaluated_joints(scene: bpy.types.Scene, armature: bpy.types.Object, frame: float) -> np.ndarray:
    """Return the world positions (J, 3) of the pose bones' heads at a scene frame, in Blender units."""
    go_to_frame(scene, frame)
    evaluated = armature.evaluated_get(bpy.context.evaluated_depsgraph_get())
    bones = evaluated.pose.bones
    return np.array([evaluated.matrix_world @ bones[joint].head for joint in layout_of(bones).joints])


def evaluated_vertices(scene: bpy.types.Scene, obj: bpy.types.Object, frame: float) -> np.ndarray:
    """Return the world positions (V, 3) of a mesh's evaluated vertices at a scene frame, in Blender units."""
    go_to_frame(scene, frame)
    evaluated = obj.evaluated_get(bpy.context.evaluated_depsgraph_get())
    world = np.array(evaluated.matrix_world, dtype=np.float64)
    return positions(evaluated.data.vertices) @ world[:3, :3].T + world[:3, 3]


def measure_deviation(
    scene: bpy.types.Scene,
    armature: bpy.types.Object,
    mesh: bpy.types.Object,
    body: BodyFile,
    motion: MotionFile,
    timing: TakeTiming,
    frames: list[int],
) -> Deviation:
    """Measure how far Blender's joints and skin are from the positions that NumPy computes for the motion."""
    times = timing.scene_frames(motion.num_frames, motion.fps)
    _, tree = pose_joints(body.rest_joints(motion.betas), rotvec_on(motion, body.layout)[frames], motion.transl[frames])
    expected = tree if motion.joints is None else motion.joints[frames]
    joints = np.stack([evaluated_joints(scene, armature, times[f]) for f in frames])
    vertices = np.stack([evaluated_vertices(scene, mesh, times[f]) for f in frames])
    scene.frame_set(scene.frame_start)
    return Deviation(_largest_mm(joints, expected), _largest_mm(vertices, skin(body, motion, frames)))


def _largest_mm(found: np.ndarray, expected: np.ndarray) -> float:
    return float(1000 * np.linalg.norm(found - expected, axis=-1).max())
