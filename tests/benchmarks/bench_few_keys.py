"""Reduce keys of takes of exercises and fast dance (10 s each, the truth of two benchmark captures).

Keys may be on every fifth frame, as the solver's are. "largest" is the largest joint distance from the full take.
"""

from __future__ import annotations

import time

import bpy
import numpy as np

from blender_addon._exchange.motion_file import MotionFile
from blender_addon.animation.action import pose_channels
from blender_addon.animation.key_reduction import thin_channels
from blender_addon.body.body_file import default_body_path, read_body
from blender_addon.body.rig import create_rig
from tests.benchmarks.comparison.captures import filmed
from tests.benchmarks.metric import Metric

TAKES = {"exercises": "13_29:600+600", "dance": "salsa_07:20+600"}
KEYS_PER_SECOND = (2, 3, 4, 10)
_SPACING = 5


def run() -> list[Metric]:
    """Reduce each take to each number of keys."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    betas = np.zeros(10)
    body = read_body(default_body_path())
    armature = create_rig("body", body, betas, bpy.context.scene.collection).armature
    metrics, seconds = [], []
    for name, take in TAKES.items():
        capture = filmed(take)
        truth, frames = capture.truth, capture.num_frames
        rotvec = np.concatenate([truth["global_orient"], truth["body_pose"]], axis=1).reshape(frames, 24, 3)
        motion = MotionFile(name, rotvec, truth["transl"], betas, capture.fps)
        channels = pose_channels(motion, armature, body.rest_joints(betas)[0])
        keyframes = np.arange(frames) % _SPACING == 0
        for rate in KEYS_PER_SECOND:
            start = time.process_time()
            deviation = thin_channels(channels, armature, keyframes, 1 + round(rate * frames / capture.fps))[1]
            seconds.append(time.process_time() - start)
            metrics.append(Metric(f"{name}_{rate}_keys_largest_mm", deviation.joints_mm, "mm", abs_tol=1.0))
    return [*metrics, Metric("thin_cpu_s", max(seconds), "s", rel_tol=0.6)]
