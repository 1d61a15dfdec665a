"""A synthetic motion of 24 bones baked onto the add-on's own body, at 1,000 and 10,000 frames; the best of three.

"action" is the curves of 24 bones and the pelvis's path alone, "bake" the whole of armature, mesh, action, overlay and
floor. Processor seconds stand beside wall seconds because machines are shared. Nothing is written.
"""

from __future__ import annotations

import time
from pathlib import Path
from tempfile import TemporaryDirectory

import bpy
import numpy as np

from blender_addon._exchange.motion_file import MotionFile, read_motion
from blender_addon.animation.action import bake_action
from blender_addon.body.body_file import BodyFile, default_body_path, read_body
from blender_addon.scene.bake import bake_take
from tests.benchmarks.metric import Metric
from tests.support.addon_stand_in import motion_arrays

LENGTHS = (1_000, 10_000)
REPEATS = 3


def run() -> list[Metric]:
    """Bake each length."""
    body = read_body(default_body_path())
    metrics = []
    for frames in LENGTHS:
        motion = synthetic_motion(frames)
        best = np.min([measure(motion, body) for _ in range(REPEATS)], axis=0)
        names = ("action_s", "action_cpu_s", "bake_s", "bake_cpu_s")
        metrics += [
            Metric(f"{name}_{frames}_frames", float(value), "s", rel_tol=1.0, abs_tol=0.05)
            for name, value in zip(names, best, strict=True)
        ]
    return metrics


def synthetic_motion(frames: int) -> MotionFile:
    """Return a walk on a circle."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "walk.npz"
        np.savez(path, **motion_arrays(default_body_path(), frames=frames))
        return read_motion(path)


def measure(motion: MotionFile, body: BodyFile) -> tuple[float, float, float, float]:
    """Return wall and processor seconds of the action alone, then of the whole bake."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    start, start_cpu = time.perf_counter(), time.process_time()
    take = bake_take(bpy.context.scene, motion, body)
    whole = time.perf_counter() - start, time.process_time() - start_cpu
    start, start_cpu = time.perf_counter(), time.process_time()
    bake_action("again", motion, take.armature, body.rest_joints(motion.betas)[0], take.timing)
    return time.perf_counter() - start, time.process_time() - start_cpu, *whole
