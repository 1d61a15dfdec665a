"""The scene is the user's: imports and solves change nothing of it without being told."""

from __future__ import annotations

from typing import Any

import bpy
import pytest

from blender_addon.conventions.timing import set_scene_frame_rate
from blender_addon.scene.session import is_untouched
from blender_addon.ui.operators.import_results import take_capture, take_motion
from tests.support.solved_capture import SolvedCapture


@pytest.fixture
def shot(mocap, scene: bpy.types.Scene) -> bpy.types.Object:
    """Return the selected set piece of a shot of the user's, with a camera, on frame 33.25."""
    set_scene_frame_rate(scene, 25.0)
    scene.frame_start, scene.frame_end = 1001, 1100
    scene.render.resolution_x, scene.render.resolution_y = 2048, 858
    scene.camera = bpy.data.objects.new("shot camera", bpy.data.cameras.new("shot camera"))
    piece = bpy.data.objects.new("set piece", bpy.data.meshes.new("set piece"))
    for obj in (scene.camera, piece):
        scene.collection.objects.link(obj)
    bpy.context.view_layer.objects.active = piece
    piece.select_set(True)
    scene.frame_set(1033, subframe=0.25)
    return piece


def state() -> tuple[Any, ...]:
    """Return what is the user's in the scene shown."""
    scene, render = bpy.context.scene, bpy.context.scene.render
    return (
        (render.fps, render.fps_base, render.resolution_x, render.resolution_y, render.pixel_aspect_x),
        (scene.frame_start, scene.frame_end, scene.frame_current, scene.frame_subframe),
        scene.camera, bpy.context.mode, bpy.context.object, sorted(obj.name for obj in bpy.context.selected_objects),
    )  # fmt: skip


def test_an_import_leaves_a_shot_as_it_is(mocap, shot, solved: SolvedCapture) -> None:
    before = state()
    assert bpy.ops.mocap.import_capture(filepath=str(solved.folder / "source.npz")) == {"FINISHED"}
    assert state() == before
    assert (mocap.review.first, mocap.review.last) == (1001, 1014)  # half a second at 25 a second
    assert mocap.capture.frame_start == 1001


def test_an_import_takes_the_recordings_set_up_if_told_so(mocap, shot, solved: SolvedCapture) -> None:
    mocap.reading.scene_setup = "TAKE"
    take_capture(bpy.context.scene, solved.read)
    scene = bpy.context.scene
    assert (scene.render.fps, scene.frame_start, scene.frame_end) == (60, 1001, 1030)
    assert scene.camera == mocap.capture.cameras[0].object


def test_a_new_scene_takes_the_recordings_set_up_unless_told_otherwise(mocap, solved: SolvedCapture) -> None:
    scene = bpy.context.scene
    assert is_untouched(scene)
    mocap.reading.scene_setup = "KEEP"
    before = state()
    take_capture(scene, solved.read)
    assert state() == before and not is_untouched(scene)


def test_reading_again_replaces_and_keeps_names_bodies_and_pins(mocap, solved: SolvedCapture) -> None:
    scene = bpy.context.scene
    take_capture(scene, solved.read)
    take = take_motion(bpy.context, solved.files)
    pin = mocap.review.pins.add()
    pin.frame = 7
    camera, view = mocap.capture.cameras[1].object, mocap.capture.cameras[1].detections
    camera.name, view.name, mocap.capture.floor.name = "the left one", "her points", "stage"
    camera.location.x += 9
    where = len(bpy.data.objects), len(bpy.data.collections), len(bpy.data.cameras), len(bpy.data.meshes)
    take_capture(scene, solved.read)
    assert (len(bpy.data.objects), len(bpy.data.collections), len(bpy.data.cameras), len(bpy.data.meshes)) == where
    item = mocap.capture.cameras[1]
    assert (item.object.name, item.detections.name, mocap.capture.floor.name) == ("the left one", "her points", "stage")
    assert item.object == camera and item.detections.parent == camera
    bpy.context.view_layer.update()
    assert abs(camera.matrix_world.translation.x) < 9
    assert mocap.review.take == take and [pin.frame for pin in mocap.review.pins] == [7]


def test_reading_again_brings_back_what_was_deleted(mocap, solved: SolvedCapture) -> None:
    scene = bpy.context.scene
    take_capture(scene, solved.read)
    bpy.data.objects.remove(mocap.capture.cameras[0].object)
    bpy.data.objects.remove(mocap.capture.floor)
    count = len(bpy.data.objects)
    take_capture(scene, solved.read)
    assert len(bpy.data.objects) == count + 2
    assert all(item.detections.parent == item.object for item in mocap.capture.cameras)
    assert all(item.object is not None and item.detections is not None for item in mocap.capture.cameras)
    assert mocap.capture.floor.name in scene.objects


def test_a_second_import_does_not_cut_the_firsts_range(mocap, solved: SolvedCapture) -> None:
    scene = bpy.context.scene
    take_capture(scene, solved.read)
    scene.frame_end = 777
    take_capture(scene, solved.read)
    assert scene.frame_end == 777


@pytest.mark.parametrize("mode", ["OBJECT", "EDIT"])
def test_a_solve_that_arrives_leaves_mode_frame_and_selection(mocap, shot, solved: SolvedCapture, mode: str) -> None:
    take_capture(bpy.context.scene, solved.read)
    bpy.ops.object.mode_set(mode=mode)
    before = state()
    first = take_motion(bpy.context, solved.files)
    assert state() == before and mocap.review.take == first
    second = take_motion(bpy.context, solved.files)
    assert state() == before and mocap.review.take == second != first


def test_a_motion_imported_into_a_shot_leaves_it_as_it_is(mocap, shot, solved: SolvedCapture) -> None:
    before = state()
    assert bpy.ops.mocap.import_motion(filepath=str(solved.folder / "take_01.npz")) == {"FINISHED"}
    assert state() == before
    (take,) = bpy.data.actions
    assert take.frame_range[1] == pytest.approx(1001 + 29 * 25 / 60, abs=1e-3)


def test_the_button_lays_everything_at_the_new_rate(mocap, solved: SolvedCapture) -> None:
    scene = bpy.context.scene
    take_capture(scene, solved.read)
    take = take_motion(bpy.context, solved.files)
    mocap.review.first, mocap.review.last = 11, 21
    pin = mocap.review.pins.add()
    pin.frame = 21
    set_scene_frame_rate(scene, 30.0)
    assert bpy.ops.mocap.follow_rate() == {"FINISHED"}
    assert take.frame_range[1] == pytest.approx(1 + 29 / 2, abs=1e-3)
    assert (mocap.review.first, mocap.review.last, pin.frame) == (6, 11, 11)


def test_a_scene_in_centimetres_gets_a_body_of_its_size(mocap, shot, solved: SolvedCapture) -> None:
    scene = bpy.context.scene
    scene.unit_settings.scale_length = 0.01
    take_capture(scene, solved.read)
    take_motion(bpy.context, solved.files)
    bpy.context.view_layer.update()
    armature = mocap.review.armature
    pelvis = armature.matrix_world @ armature.pose.bones["pelvis"].head
    assert 70 < pelvis.z < 130  # centimetres
    assert min(camera.matrix_world.translation.length for camera in (i.object for i in mocap.capture.cameras)) > 100
