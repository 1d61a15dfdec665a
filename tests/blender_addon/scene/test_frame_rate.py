"""Everything of ours lies by time at any scene rate, and follows when the rate changes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest

from blender_addon.animation.curves import RATE, action_curves, laid_rate
from blender_addon.animation.deviation import evaluated_joints
from blender_addon.animation.lanes import read_lane
from blender_addon.animation.takes import push_down
from blender_addon.conventions.timing import set_scene_frame_rate
from blender_addon.scene.bake import BakedTake, BakeSettings, bake_take
from blender_addon.scene.frame_rate import needs_relaying, relay
from blender_addon.scene.point_player import played_rate

KEPT = BakeSettings(frame_start=5, set_scene=False)


def footage_of(folder: Path, camera: Any, count: int) -> Any:
    """Return the camera with so many numbered pictures."""
    folder.mkdir()
    image = bpy.data.images.new("picture", 4, 4)
    for number in range(1, count + 1):
        image.filepath_raw, image.file_format = str(folder / f"{number:04d}.png"), "PNG"
        image.save()
    bpy.data.images.remove(image)
    return replace(camera, footage=folder)


def shown_picture(camera: bpy.types.Object) -> int:
    """Return the number of the picture that Blender shows, as its image user computes it."""
    scene, depsgraph = bpy.context.scene, bpy.context.evaluated_depsgraph_get()
    user = camera.evaluated_get(depsgraph).data.background_images[0].image_user
    return min(max(scene.frame_current - user.frame_start + 1, 1), user.frame_duration) + user.frame_offset


@pytest.mark.parametrize("scene_fps", [24.0, 25.0, 29.97, 60.0, 23.976, 144.0])
def test_footage_shows_the_picture_that_was_taken_then(
    scene: bpy.types.Scene, files: Any, tmp_path: Path, scene_fps: float
) -> None:
    """One picture a scene frame, as Blender has it, is right at the recording's own rate alone."""
    set_scene_frame_rate(scene, scene_fps)
    cameras = (footage_of(tmp_path / "cam", files.capture.cameras[0], 60), *files.capture.cameras[1:])
    capture = replace(files.capture, cameras=cameras, fps=60.0)
    take = bake_take(scene, replace(files.motion, fps=60.0), files.body, capture, KEPT)
    for frame in (1, 5, 6, 11, 17, 28, 200):
        scene.frame_set(frame)
        expected = 1 + min(max(np.floor((frame - 5) * 60 / scene_fps + 0.5), 0), 59)
        assert shown_picture(take.cameras[0]) == expected, frame


def test_motion_and_detections_follow_a_new_rate(scene: bpy.types.Scene, take: BakedTake, files: Any) -> None:
    fps = files.motion.fps
    assert not needs_relaying(scene)
    knee = next(c for c in action_curves(take.action) if "left_knee" in c.data_path)
    knee.keyframe_points[30].co.y += 0.01  # an edit by hand
    edited = knee.keyframe_points[30].co.y
    set_scene_frame_rate(scene, 24.0)
    assert needs_relaying(scene)
    assert relay(scene) == pytest.approx(24.0 / fps)
    assert not needs_relaying(scene) and take.action[RATE] == 24.0
    keys = np.array([p.co.x for p in knee.keyframe_points])
    np.testing.assert_allclose((keys - 1) / 24, np.arange(60) / fps, atol=1e-5)
    assert knee.keyframe_points[30].co.y == edited
    np.testing.assert_allclose(
        evaluated_joints(scene, take.armature, float(keys[20])), files.motion.joints[20], atol=1e-3
    )
    assert all(played_rate(obj) == pytest.approx(obj["fps"] / 24) for obj in take.overlays)
    set_scene_frame_rate(scene, fps)
    relay(scene)
    np.testing.assert_allclose([p.co.x for p in knee.keyframe_points], np.arange(1, 61), atol=1e-3)


def test_confidence_follows(scene: bpy.types.Scene, files: Any) -> None:
    motion = replace(files.motion, joint_sigma=np.full((60, 24), 0.01))
    take = bake_take(scene, motion, files.body)
    set_scene_frame_rate(scene, 2 * motion.fps)
    relay(scene)
    lane = read_lane(take.action)
    assert lane is not None
    np.testing.assert_allclose(lane[0], 1 + 2 * np.arange(60), atol=1e-3)


def test_takes_on_the_nla_follow(scene: bpy.types.Scene, take: BakedTake) -> None:
    strip = push_down(take.armature)
    assert strip is not None
    set_scene_frame_rate(scene, 2 * laid_rate(take.action))
    assert needs_relaying(scene)
    relay(scene)
    assert (strip.frame_start, strip.frame_end) == pytest.approx((1, 119), abs=1e-3)
