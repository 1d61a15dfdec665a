"""Create the bundled body in Blender, and play 200 frames in which every bone rotates. The best of three counts.

"playback" is ``frame_set`` with all drivers, bones, 217 shape keys and the skin evaluated, and nothing drawn. Times are
processor seconds of all threads, because machines are shared. Deviations are from the model over those frames.
"""

from __future__ import annotations

import time

import bpy
import numpy as np

from blender_addon._exchange.motion_file import MotionFile
from blender_addon.animation.action import bake_action
from blender_addon.animation.deviation import measure_deviation
from blender_addon.body.body_file import default_body_path, read_body
from blender_addon.body.rig import create_rig
from blender_addon.conventions.timing import TakeTiming
from tests.benchmarks.metric import Metric

FRAMES, FPS, REPEATS = 200, 30.0, 3


def run() -> list[Metric]:
    """Create the body, animate it, and play it."""
    body, motion = read_body(default_body_path()), moving_everywhere()
    made, played = [], []
    for _ in range(REPEATS):
        bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
        start = time.process_time()
        rig = create_rig("Body", body, motion.betas, bpy.context.scene.collection)
        made.append(time.process_time() - start)
        timing = TakeTiming(1, FPS)
        bake_action("moving", motion, rig.armature, body.rest_joints(motion.betas)[0], timing)
        played.append(play(bpy.context.scene))
    frames = list(range(0, FRAMES, 10))
    deviation = measure_deviation(bpy.context.scene, rig.armature, rig.mesh, body, motion, timing, frames)
    return [
        Metric("make_cpu_s", min(made), "s", rel_tol=0.5, abs_tol=0.2),
        Metric("playback_cpu_ms", 1e3 * min(played), "ms/frame", rel_tol=0.5, abs_tol=3.0),
        Metric("skin_deviation_mm", deviation.skin_mm, "mm", abs_tol=0.05),
        Metric("joints_deviation_mm", deviation.joints_mm, "mm", abs_tol=0.02),
    ]


def moving_everywhere() -> MotionFile:
    """Return a motion in which each joint swings by half a radian at a different rate."""
    rng = np.random.default_rng(0)
    time_s = np.arange(FRAMES)[:, None, None] / FPS
    rotvec = 0.5 * np.sin(2 * time_s * rng.normal(size=(1, 24, 3)) + rng.normal(size=(1, 24, 3)))
    return MotionFile("moving", rotvec, np.zeros((FRAMES, 3)), rng.normal(size=10), FPS)


def play(scene: bpy.types.Scene) -> float:
    """Return processor seconds per frame."""
    scene.frame_set(1)
    start = time.process_time()
    for frame in range(1, FRAMES + 1):
        scene.frame_set(frame)
    return (time.process_time() - start) / FRAMES
