"""Takes with few keys, takes laid aside and takes offered as assets."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import bpy
import numpy as np
import pytest

from blender_addon.animation.action import bake_action, pose_channels
from blender_addon.animation.curves import action_curves
from blender_addon.animation.deviation import evaluated_joints
from blender_addon.animation.key_reduction import Distance, reduce_keys
from blender_addon.animation.sparse_curves import SparseCurves
from blender_addon.animation.takes import mark_as_asset, push_down
from blender_addon.scene.bake import BakedTake, BakeSettings, bake_take


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


def test_few_keys_are_true_to_the_take_at_the_keys_and_say_how_far_between(scene: Any, files: Any) -> None:
    motion = smooth_motion(files.motion)
    full = bake_take(scene, motion, files.body)
    expected = np.stack([evaluated_joints(scene, full.armature, frame) for frame in range(1, 241)])
    action = bake_action("few", motion, full.armature, files.body.rest_joints(motion.betas)[0], full.timing, 2.0)
    curves = list(action_curves(action))
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
    assert action["keys_deviation"].startswith("17 keys are left: joints are up to ")


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


def apart(values: np.ndarray) -> Distance:
    return lambda first, found: np.linalg.norm(found - values[first : first + len(found)], axis=1)


def test_reduction_recovers_a_smooth_spline_exactly() -> None:
    """Curves that are cubic between known keys need just those keys, and they are found."""
    frames = np.array([0, 12, 20, 47, 60])
    at = np.arange(61)
    values = np.stack([np.where(at < 20, 0.0, (at - 20.0) ** 3 * 1e-4), (at - 30.0) ** 2 * 1e-2], axis=1)
    found = reduce_keys(values, np.arange(61), 3, apart(values))
    assert found.frames.tolist() == [0, pytest.approx(20, abs=1), 60]
    exact = reduce_keys(values, frames, 5, apart(values))
    assert exact.frames.tolist() == frames.tolist()
    np.testing.assert_allclose(exact.sampled(61), values, atol=5e-3)


def test_slopes_are_the_least_squares_ones() -> None:
    rng = np.random.default_rng(0)
    values = np.cumsum(rng.normal(size=(50, 3)), axis=0)
    best = SparseCurves.fitted(values, np.array([0, 9, 30, 49]))
    error = ((best.sampled(50) - values) ** 2).sum()
    for k in range(4):
        for step in (-0.05, 0.05):
            other = best.slopes.copy()
            other[k, 0] += step
            assert ((replace(best, slopes=other).sampled(50) - values) ** 2).sum() > error * 0.9999


def test_keys_are_moved_to_where_they_serve_best() -> None:
    """On a wave that quickens, keys at even times are far worse, and no step of a key makes it better."""
    values = np.sin((np.arange(300.0) / 60) ** 2)[:, None]
    curves = reduce_keys(values, np.arange(300), 30, apart(values))

    def worst(frames: np.ndarray) -> float:
        found = SparseCurves.fitted(values, frames).sampled(300)
        return float((apart(values)(0, found) ** 6).sum() ** (1 / 6))

    least = worst(curves.frames)
    assert least < 0.6 * worst(np.linspace(0, 299, 30).astype(int))
    steps = [
        frames + step * (np.arange(30) == k) for k in range(1, 29) for step in (-1, 1) for frames in [curves.frames]
    ]
    assert min(map(worst, steps)) > 0.95 * least


def test_keys_lie_where_things_happen_and_extremes_work() -> None:
    at = np.arange(200.0)
    values = np.where(at[:, None] < 150, 0.0, np.sin((at[:, None] - 150) / 4))
    keys = reduce_keys(values, np.arange(200), 12, apart(values)).frames
    assert len(keys) == 12 and (keys > 145).sum() >= 9
    assert reduce_keys(values, np.array([], int), 10, apart(values)).frames.tolist() == [0, 199]
    assert reduce_keys(values[:2], np.arange(2), 9, apart(values)).frames.tolist() == [0, 1]
    one = reduce_keys(values[:1], np.arange(1), 2, apart(values))
    np.testing.assert_array_equal(one.sampled(1), values[:1])
    full = reduce_keys(values, np.arange(200), 500, apart(values))
    np.testing.assert_allclose(full.sampled(200), values, atol=1e-12)


def test_a_pushed_down_take_waits_on_the_nla_and_plays_again(scene: Any, take: BakedTake, files: Any) -> None:
    strip = push_down(take.armature)
    animation = take.armature.animation_data
    assert strip is not None and strip.action is take.action and animation.action is None
    assert (strip.frame_start, strip.frame_end) == (1, 60)
    track = animation.nla_tracks[take.action.name]
    assert track.mute
    track.mute = False
    np.testing.assert_allclose(evaluated_joints(scene, take.armature, 31), files.motion.joints[30], atol=1e-4)
    assert push_down(take.armature) is None
    rest = files.body.rest_joints(files.motion.betas)[0]
    again = bake_action("second", files.motion, take.armature, rest, take.timing)
    assert animation.action is again and len(animation.nla_tracks) == 1 and take.action.use_fake_user


def test_a_take_becomes_an_asset(scene: Any, files: Any) -> None:
    take = bake_take(scene, files.motion, files.body, settings=BakeSettings(asset=True))
    assert take.action.asset_data.description == "Solved take: 60 frames, solved at 30 fps"
    assert {tag.name for tag in take.action.asset_data.tags} == {"motion capture", "take"}
    mark_as_asset(take.action)
    assert len(take.action.asset_data.tags) == 2
    assert bpy.data.actions[take.action.name].use_fake_user
