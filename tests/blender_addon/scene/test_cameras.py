"""Cameras and overlays: what OpenCV projects, Blender projects."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Vector

from blender_addon._exchange.capture_file import CameraFile
from blender_addon._exchange.lens import normalised, pixels, undistort
from blender_addon.conventions.coordinates import SENSOR_WIDTH_MM, camera_to_world, lens_from_intrinsics
from blender_addon.conventions.skeleton import JOINTS
from blender_addon.render.picture import write_png
from blender_addon.scene.bake import BakedTake, BakeSettings, bake_take
from blender_addon.scene.cameras import create_camera, find_footage, look_through

_RNG = np.random.default_rng(5)


def _pinhole(camera: CameraFile, points: np.ndarray) -> np.ndarray:
    p = points @ camera.R.T + camera.t
    return pixels(p[..., :2] / p[..., 2:], camera.K)


def _blender_pixels(
    scene: bpy.types.Scene, camera: bpy.types.Object, size: tuple[int, int], points: np.ndarray
) -> np.ndarray:
    seen = np.array([world_to_camera_view(scene, camera, Vector(p)) for p in points])
    return np.stack([seen[:, 0] * size[0] - 0.5, (1 - seen[:, 1]) * size[1] - 0.5], -1)


@pytest.mark.parametrize("index", range(4))
def test_projection_is_opencvs(scene: bpy.types.Scene, files: Any, index: int) -> None:
    source = files.capture.cameras[index]
    camera = create_camera(source, scene.collection)
    look_through(scene, camera)
    bpy.context.view_layer.update()
    points = _RNG.uniform([-1.5, -1.5, 0], [1.5, 1.5, 2], size=(50, 3))
    expected = _pinhole(source, points)
    found = _blender_pixels(scene, camera, source.image_size, points)
    assert np.abs(found - expected).max() < 0.1
    assert np.abs(found - expected).max() < 0.01, "float32 matrices leave a few thousandths of a pixel"


def test_a_lens_has_its_intrinsics() -> None:
    for _ in range(20):
        size = tuple(int(v) for v in _RNG.integers(100, 4000, size=2))
        K = np.eye(3)
        K[0, 0], K[1, 1] = _RNG.uniform(200, 3000, size=2)
        K[:2, 2] = _RNG.uniform(0, 2000, size=2)
        lens = lens_from_intrinsics(K, size)
        assert min(lens.pixel_aspect) == 1.0
        (width, height), aspect = size, lens.pixel_aspect[1] / lens.pixel_aspect[0]
        fx = lens.focal_mm * width / SENSOR_WIDTH_MM
        centre = width / 2 - 0.5 - lens.shift_x * width, height / 2 - 0.5 + lens.shift_y * width / aspect
        found = [[fx, 0.0, centre[0]], [0.0, fx / aspect, centre[1]], [0.0, 0.0, 1.0]]
        np.testing.assert_allclose(found, K, rtol=1e-12, atol=1e-9)


def test_camera_looks_along_opencvs_z() -> None:
    T = camera_to_world(np.eye(3), np.array([1.0, 2.0, 3.0]))
    np.testing.assert_array_equal(T[:3, 3], [-1, -2, -3])
    np.testing.assert_array_equal(T[:3, :3] @ [0, 0, -1], [0, 0, 1])
    np.testing.assert_array_equal(T[:3, :3] @ [0, 1, 0], [0, -1, 0])


def test_cameras_are_named_and_the_first_is_the_scenes(scene: bpy.types.Scene, take: BakedTake) -> None:
    assert [camera.name for camera in take.cameras] == ["front", "left side", "back", "right"]
    assert scene.camera is take.cameras[0]
    assert (scene.render.resolution_x, scene.render.resolution_y) == (1920, 1080)


@pytest.mark.parametrize("frame", [1, 4, 31, 60])
def test_view_overlay_covers_the_undistorted_detections(
    scene: bpy.types.Scene, take: BakedTake, files: Any, frame: int
) -> None:
    for index in (1, 2):
        overlay, source = take.overlays[1 + index], files.capture.cameras[index]
        assert overlay.name == f"{source.name} detections" and overlay.parent is take.cameras[index]
        look_through(scene, take.cameras[index])
        balls = _ball_centres(scene, overlay, frame)
        xy = files.capture.xy[index, frame - 1]
        straight = undistort(normalised(xy, source.K), source.distortion, source.distortion_model)
        expected = pixels(straight, source.K)[np.isfinite(xy).all(-1)]
        assert len(balls) == len(expected) == (23 if (index, frame) == (1, 4) else 24)
        found = _blender_pixels(scene, take.cameras[index], source.image_size, balls)
        assert np.abs(found - expected).max() < 0.1
        joints = _pinhole(source, files.motion.joints[frame - 1])[np.isfinite(xy).all(-1)]
        assert np.abs(found - joints).max() < 0.1, "undistorted detections lie on the joints they were made from"


def test_triangulated_overlay_plays_the_keypoints(scene: bpy.types.Scene, take: BakedTake, files: Any) -> None:
    overlay = take.overlays[0]
    assert overlay.animation_data is None and not bpy.app.handlers.frame_change_post
    for frame in (1, 31, 60):
        keypoints = files.motion.keypoints3d[frame - 1]
        seen = np.isfinite(keypoints).all(-1)
        assert seen.sum() == (16 if frame == 31 else 17)
        np.testing.assert_allclose(_ball_centres(scene, overlay, frame), keypoints[seen], atol=1e-5)
    np.testing.assert_allclose(_ball_centres(scene, overlay, 500), files.motion.keypoints3d[-1], atol=1e-5)


def test_overlay_keeps_time_in_a_scene_of_another_rate(scene: bpy.types.Scene, files: Any) -> None:
    scene.render.fps = 60
    take = bake_take(scene, files.motion, files.body, settings=BakeSettings(set_scene=False, frame_start=5))
    expected = files.motion.keypoints3d[20]
    np.testing.assert_allclose(_ball_centres(scene, take.overlays[0], 45), expected, atol=1e-5)


def test_overlays_stay_out_of_renders(take: BakedTake) -> None:
    assert len(take.overlays) == 5 and all(overlay.hide_render for overlay in take.overlays)


def test_markers_become_an_overlay(scene: bpy.types.Scene, files: Any) -> None:
    markers = files.motion.joints[:, :5].copy()
    markers[2, 1] = np.nan
    capture = replace(files.capture, cameras=(), xy=None, confidence=None, markers=markers)
    take = bake_take(scene, files.motion, files.body, capture)
    assert take.cameras == () and [o.name for o in take.overlays] == ["Triangulated keypoints", "Markers"]
    assert len(_ball_centres(scene, take.overlays[1], 3)) == 4


def test_missing_footage_is_a_note(scene: bpy.types.Scene, files: Any, tmp_path: Path) -> None:
    cameras = (replace(files.capture.cameras[0], footage=tmp_path / "gone.mp4"), *files.capture.cameras[1:])
    take = bake_take(scene, files.motion, files.body, replace(files.capture, cameras=cameras))
    assert take.notes == (f"Camera front: no video or images at {tmp_path / 'gone.mp4'}.",)
    assert not take.cameras[0].data.background_images


def test_image_sequence_becomes_a_background(scene: bpy.types.Scene, files: Any, tmp_path: Path) -> None:
    for number in (9, 10, 11):
        write_png(tmp_path / f"img_{number}.png", np.full((9, 16, 3), 20 * number, np.uint8))
    cameras = (replace(files.capture.cameras[0], footage=tmp_path),)
    capture = replace(files.capture, cameras=cameras, xy=files.capture.xy[:1], confidence=files.capture.confidence[:1])
    take = bake_take(scene, files.motion, files.body, capture, BakeSettings(frame_start=101))
    background = take.cameras[0].data.background_images[0]
    assert background.image.source == "SEQUENCE" and take.cameras[0].data.show_background_images
    user = background.image_user
    assert (user.frame_start, user.frame_duration, user.frame_offset) == (101, 3, 8)
    assert take.notes == ()


def test_unreadable_footage_is_a_note(scene: bpy.types.Scene, files: Any, tmp_path: Path) -> None:
    (tmp_path / "broken.mp4").write_bytes(b"not a video")
    cameras = (replace(files.capture.cameras[0], footage=tmp_path / "broken.mp4"), *files.capture.cameras[1:])
    take = bake_take(scene, files.motion, files.body, replace(files.capture, cameras=cameras))
    assert take.notes == ("Camera front: Blender cannot read broken.mp4.",)


def test_footage_is_found_in_natural_order(tmp_path: Path) -> None:
    for name in ("b10.JPG", "b9.jpg", "notes.txt"):
        (tmp_path / name).touch()
    found = find_footage(tmp_path)
    assert found is not None and [p.name for p in found.files] == ["b9.jpg", "b10.JPG"] and not found.is_video
    assert find_footage(None) is None and find_footage(tmp_path / "notes.txt") is None


def test_skew_and_other_lengths_are_notes(scene: bpy.types.Scene, files: Any) -> None:
    K = files.capture.cameras[0].K.copy()
    K[0, 1] = 1.5
    cameras = (replace(files.capture.cameras[0], K=K), *files.capture.cameras[1:])
    capture = replace(files.capture, cameras=cameras, fps=60.0, xy=files.capture.xy[:, :50], confidence=None)
    notes = bake_take(scene, files.motion, files.body, capture).notes
    assert notes == (
        "The capture has 50 frames and the motion 60. Both start together.",
        "The capture runs at 60 fps and the motion at 30, aligned by time.",
        "Camera front: its skew of 1.5 px is ignored.",
    )


def test_floor_lies_under_the_whole_walk(take: BakedTake, files: Any) -> None:
    corners = np.array([v.co for v in take.floor.data.vertices])
    assert (corners[:, 2] == 0).all()
    for axis in (0, 1):
        assert corners[:, axis].min() < files.motion.joints[..., axis].min() - 0.9
        assert corners[:, axis].max() > files.motion.joints[..., axis].max() + 0.9
    area = sum(p.area for p in take.floor.data.polygons)
    assert area == pytest.approx(np.prod(np.ptp(corners[:, :2], axis=0)), rel=1e-5), "quads do not overlap"


def test_pelvis_bone_is_where_the_first_camera_sees_it(scene: bpy.types.Scene, take: BakedTake, files: Any) -> None:
    scene.frame_set(17)
    look_through(scene, take.cameras[3])
    evaluated = take.armature.evaluated_get(bpy.context.evaluated_depsgraph_get())
    world = np.array([evaluated.matrix_world @ evaluated.pose.bones[j].head for j in JOINTS])
    found = _blender_pixels(scene, take.cameras[3], files.capture.cameras[3].image_size, world)
    assert np.abs(found - files.capture.xy[3, 16]).max() < 0.1, "this camera has no distortion"


def _ball_centres(scene: bpy.types.Scene, overlay: bpy.types.Object, frame: int) -> np.ndarray:
    scene.frame_set(frame)
    evaluated = overlay.evaluated_get(bpy.context.evaluated_depsgraph_get())
    co = np.array([evaluated.matrix_world @ v.co for v in evaluated.data.vertices])
    return co.reshape(-1, 42, 3).mean(axis=1)
