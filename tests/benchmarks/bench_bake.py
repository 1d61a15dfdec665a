"""Bake a synthetic motion of 1,000 and 10,000 frames on the add-on's body, with 24 bones and with 52 including fingers.

The best of three runs counts. "action" includes only the curves of bones and pelvis. "bake" includes armature, mesh,
action, overlay and floor. Processor seconds are given with wall seconds because machines are shared. No file is
written.
"""

from __future__ import annotations

import time
from pathlib import Path
from tempfile import TemporaryDirectory

import bpy
import numpy as np

from blender_addon._exchange.body_layout import SMPL_HANDS
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
    metrics = [metric for frames in LENGTHS for metric in _metrics(f"{frames}_frames", synthetic_motion(frames), body)]
    fingered = read_body(default_body_path(), SMPL_HANDS)
    wide = _metrics(f"{LENGTHS[-1]}_frames_52_bones", moving_everything(LENGTHS[-1]), fingered)
    return [*metrics, *(metric for metric in wide if "_cpu_" in metric.key)]


def _metrics(case: str, motion: MotionFile, body: BodyFile) -> list[Metric]:
    best = np.min([measure(motion, body) for _ in range(REPEATS)], axis=0)
    names = ("action_s", "action_cpu_s", "bake_s", "bake_cpu_s")
    return [
        Metric(f"{name}_{case}", float(value), "s", rel_tol=1.0, abs_tol=0.05)
        for name, value in zip(names, best, strict=True)
    ]


def moving_everything(frames: int, fps: float = 60.0) -> MotionFile:
    """Return a motion of 52 joints that all rotate."""
    t = np.arange(frames)[:, None, None] / fps
    rotvec = 0.3 * np.sin(t * np.linspace(1.0, 3.0, SMPL_HANDS.num_joints)[None, :, None] + np.arange(3))
    transl = np.tile([0.0, 0.0, 0.95], (frames, 1))
    return MotionFile("fingers", rotvec, transl, np.zeros(10), fps, "manifold_neutral", SMPL_HANDS)


def synthetic_motion(frames: int) -> MotionFile:
    """Return a walk on a circle."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "walk.npz"
        np.savez(path, **motion_arrays(default_body_path(), frames=frames))
        return read_motion(path)


def measure(motion: MotionFile, body: BodyFile) -> tuple[float, float, float, float]:
    """Return wall and processor seconds of the action, then of the whole bake."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    start, start_cpu = time.perf_counter(), time.process_time()
    take = bake_take(bpy.context.scene, motion, body)
    whole = time.perf_counter() - start, time.process_time() - start_cpu
    start, start_cpu = time.perf_counter(), time.process_time()
    bake_action("again", motion, take.armature, body.rest_joints(motion.betas)[0], take.timing)
    return time.perf_counter() - start, time.process_time() - start_cpu, *whole
