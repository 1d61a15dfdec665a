"""Takes with few keys."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from blender_addon.animation.action import bake_action, pose_channels
from blender_addon.animation.curves import action_curves
from blender_addon.animation.deviation import evaluated_joints
from blender_addon.scene.bake import BakeSettings, bake_take


def smooth_motion(motion: Any, frames: int = 240) -> Any:
    """Return the stand-in's motion four times as slow, with solver keys every fifth frame."""
    at = np.linspace(0, motion.num_frames - 1, frames)
    left = np.minimum(at.astype(int), motion.num_frames - 2)
    part = (at - left)[:, None]
    keyframes = np.zeros(frames, bool)
    keyframes[::5] = True
    return replace(
        motion, rotvec=motion.rotvec[left] * (1 - part[..., None]) + motion.rotvec[left + 1] * part[..., None],
        transl=motion.transl[left] * (1 - part) + motion.transl[left + 1] * part,
        joints=None, keypoints3d=None, keyframes=keyframes,
    )  # fmt: skip


@pytest.mark.slow
def test_few_keys_are_true_to_the_take_at_the_keys_and_say_how_far_between(scene: Any, files: Any) -> None:
    motion = smooth_motion(files.motion)
    full = bake_take(scene, motion, files.body)
    expected = np.stack([evaluated_joints(scene, full.armature, frame) for frame in range(1, 241)])
    action = bake_action("few", motion, full.armature, files.body.rest_joints(motion.betas)[0], full.timing, 2.0)
    curves = [c for c in action_curves(action) if not c.data_path.startswith('pose.bones["root"]')]  # limbs' switches
    keys = np.array([p.co.x for p in curves[0].keyframe_points])
    assert len(keys) == 17 and all([p.co.x for p in c.keyframe_points] == keys.tolist() for c in curves)
    assert set(keys[:-1].astype(int)) <= set(np.flatnonzero(motion.keyframes) + 1) and keys[-1] == 240
    assert {p.interpolation for c in curves for p in c.keyframe_points} == {"BEZIER"}
    assert {p.type for c in curves for p in c.keyframe_points} == {"KEYFRAME"}
    found = np.stack([evaluated_joints(scene, full.armature, frame) for frame in range(1, 241)])
    off_mm = 1000 * np.linalg.norm(found - expected, axis=-1)
    assert off_mm[keys.astype(int) - 1].max() < 0.05
    assert off_mm.max() == pytest.approx(action["keys_deviation_mm"], abs=0.05)
    assert 0.1 < off_mm.max() < 60 and 0 < action["keys_deviation_degrees"] < 15
    assert action["keys_deviation"].startswith("17 keys remain. Joints are up to ")


def test_few_keys_at_another_scene_rate(scene: Any, files: Any) -> None:
    scene.render.fps = 24
    motion = replace(smooth_motion(files.motion), fps=60.0)
    settings = BakeSettings(frame_start=11, set_scene=False, keys_per_second=3.0)
    take = bake_take(scene, motion, files.body, settings=settings)
    curves = list(action_curves(take.action))
    assert len(curves[0].keyframe_points) == 13
    times = take.timing.scene_frames(240, 60.0)
    sampled = np.array([[curve.evaluate(t) for curve in curves] for t in times])
    exact = pose_channels(motion, take.armature, files.body.rest_joints(motion.betas)[0])
    by_name = {(c.data_path, c.array_index): i for i, c in enumerate(curves)}
    order = [by_name[key] for key in _channel_names()]
    kept = np.round((np.array([p.co.x for p in curves[0].keyframe_points]) - 11) / 24 * 60).astype(int)
    np.testing.assert_allclose(sampled[kept][:, order], exact[kept], atol=1e-5)
    assert np.abs(sampled[:, order] - exact).max() < 0.08
    assert take.action["keys_deviation"] in take.notes


def _channel_names() -> list[tuple[str, int]]:
    from blender_addon.conventions.skeleton import JOINTS

    names = [(f'pose.bones["{JOINTS[0]}"].location', i) for i in range(3)]
    return names + [(f'pose.bones["{j}"].rotation_quaternion', i) for j in JOINTS for i in range(4)]
