"""The bake: what Blender evaluates is the motion, at the right time."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import bpy
import numpy as np
import pytest

from blender_addon.animation.curves import action_curves
from blender_addon.animation.deviation import evaluated_joints, measure_deviation
from blender_addon.body.body_file import default_body_path, read_body
from blender_addon.conventions.timing import scene_frame_rate
from blender_addon.errors import BodyMismatch
from blender_addon.scene.bake import BakedTake, BakeSettings, bake_take


def test_evaluated_joints_and_skin_match_numpy(scene: bpy.types.Scene, take: BakedTake, files: Any) -> None:
    frames = list(range(0, 60, 7))
    deviation = measure_deviation(scene, take.armature, take.mesh, files.body, files.motion, take.timing, frames)
    assert deviation.joints_mm <= 0.1
    assert deviation.skin_mm <= 0.1


def test_product_body_matches_numpy(scene: bpy.types.Scene, files: Any) -> None:
    body = read_body(default_body_path())
    motion = replace(files.motion, body=body.id, joints=None)
    take = bake_take(scene, motion, body)
    deviation = measure_deviation(scene, take.armature, take.mesh, body, motion, take.timing, [0, 25, 59])
    assert deviation.joints_mm <= 0.1
    assert deviation.skin_mm <= 0.1


def test_far_from_the_origin_and_upside_down(scene: bpy.types.Scene, files: Any) -> None:
    rotvec = files.motion.rotvec.copy()
    rotvec[:, 0] = [np.pi - 1e-7, 0, 0]
    motion = replace(files.motion, rotvec=rotvec, transl=files.motion.transl + [80.0, -60.0, 3.0], joints=None)
    take = bake_take(scene, motion, files.body)
    deviation = measure_deviation(scene, take.armature, take.mesh, files.body, motion, take.timing, [0, 59])
    assert deviation.joints_mm <= 0.1


@pytest.mark.parametrize("fps", [24.0, 59.94, 60000 / 1001, 29.97, 12.5, 120.0, 0.5, 99.7])
def test_frame_rate_is_kept_by_time(scene: bpy.types.Scene, files: Any, fps: float) -> None:
    take = bake_take(scene, replace(files.motion, fps=fps), files.body)
    assert scene_frame_rate(scene) == pytest.approx(fps, rel=1e-6)
    assert (scene.frame_start, scene.frame_end) == (1, 60)
    keys = [p.co.x for p in next(action_curves(take.action)).keyframe_points]
    assert keys == list(range(1, 61))


def test_scene_that_keeps_its_rate_gets_keys_by_time(scene: bpy.types.Scene, files: Any) -> None:
    scene.render.fps, scene.render.fps_base = 24, 1.0
    scene.frame_end = 500
    motion = replace(files.motion, fps=59.94)
    take = bake_take(scene, motion, files.body, settings=BakeSettings(frame_start=10, set_scene=False))
    keys = np.array([p.co.x for p in next(action_curves(take.action)).keyframe_points])
    np.testing.assert_allclose((keys - 10) / 24, np.arange(60) / 59.94, atol=1e-6)
    assert (scene_frame_rate(scene), scene.frame_end) == (24.0, 500)
    found = evaluated_joints(scene, take.armature, float(keys[37]))
    np.testing.assert_allclose(found, motion.joints[37], atol=1e-4)


def test_one_frame_bakes(scene: bpy.types.Scene, files: Any) -> None:
    motion = files.motion
    one = replace(
        motion, rotvec=motion.rotvec[:1], transl=motion.transl[:1], joints=motion.joints[:1],
        keypoints3d=motion.keypoints3d[:1], keyframes=motion.keyframes[:1],
    )  # fmt: skip
    take = bake_take(scene, one, files.body)
    assert scene.frame_start == scene.frame_end == 1
    np.testing.assert_allclose(evaluated_joints(scene, take.armature, 1), motion.joints[0], atol=1e-4)


def test_a_motion_of_markers_bakes(scene: bpy.types.Scene, files: Any) -> None:
    without = replace(files.motion, keypoints3d=None, joint_set="", reprojection_px=None)
    take = bake_take(scene, without, files.body)
    np.testing.assert_allclose(evaluated_joints(scene, take.armature, 1), files.motion.joints[0], atol=1e-4)


def test_a_baked_takes_markers_have_the_colour_of_their_residual(scene: bpy.types.Scene, files: Any) -> None:
    count = files.motion.num_frames
    points = files.motion.joints[:, :2]
    motion = replace(
        files.motion, marker_labels=("b", "a"), marker_residual_mm=np.tile([30.0, 5.0], (count, 1)), keypoints3d=None
    )
    capture = replace(
        files.capture, cameras=(), xy=None, confidence=None, markers=points, marker_labels=("a", "b"), fps=motion.fps
    )
    take = bake_take(scene, motion, files.body, capture)
    (cloud,) = take.overlays
    grades = np.array([item.value for item in cloud.data.attributes["grade"].data]).reshape(count, 2)
    assert (grades == [1, 3]).all()


def test_two_takes_share_a_scene(scene: bpy.types.Scene, take: BakedTake, files: Any) -> None:
    other = bake_take(scene, files.motion, files.body)
    assert other.armature is not take.armature and other.action is not take.action
    assert take.armature.animation_data.action is take.action
    assert len(bpy.data.actions) == 2


def test_motion_of_another_body_is_refused(scene: bpy.types.Scene, files: Any) -> None:
    with pytest.raises(BodyMismatch, match="solved with the body 'other', not 'stand_in'"):
        bake_take(scene, replace(files.motion, body="other"), files.body)
    assert not bpy.data.armatures and not bpy.data.actions
