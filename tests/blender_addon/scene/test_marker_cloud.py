"""Markers as one object: named points that play, and take the colour of their residual."""

from __future__ import annotations

import bpy
import numpy as np
import pytest

from blender_addon.conventions.datablocks import MARKER_COLOURS
from blender_addon.conventions.timing import TakeTiming
from blender_addon.scene.overlay import create_marker_cloud, grade_markers, labels_of, marker_positions
from blender_addon.scene.point_player import set_played_rate
from tests.support.addon_stand_in import bare_motion

FRAMES, LABELS = 12, ("Anna:LFHD", "Anna:RFHD", "Anna:C7", "Anna:wand")


@pytest.fixture
def points() -> np.ndarray:
    points = np.random.default_rng(3).uniform(-1, 1, (FRAMES, len(LABELS), 3))
    points[5, 1] = np.nan
    return points


@pytest.fixture
def cloud(scene: bpy.types.Scene, points: np.ndarray) -> bpy.types.Object:
    scene.render.fps = 60
    return create_marker_cloud(points, LABELS, 120.0, TakeTiming(11, 60.0), scene.collection)


def shown(scene: bpy.types.Scene, cloud: bpy.types.Object, frame: int) -> dict[int, np.ndarray]:
    """Return the centres of the balls on a frame by the number of their material."""
    scene.frame_set(frame)
    mesh = cloud.evaluated_get(bpy.context.evaluated_depsgraph_get()).to_mesh()
    corners = np.array([vertex.co[:] for vertex in mesh.vertices])
    faces = np.array([face.material_index for face in mesh.polygons])
    inside = np.array([face.vertices[:] for face in mesh.polygons])
    materials = [material and tuple(np.round(material.diffuse_color, 3)) for material in mesh.materials]
    colours = [tuple(np.round(colour, 3)) for colour in MARKER_COLOURS]
    found: dict[int, np.ndarray] = {}
    for index in np.unique(faces):
        used = np.unique(inside[faces == index])
        balls = corners[used].reshape(-1, 42, 3)  # an icosphere of two subdivisions
        found[colours.index(materials[index])] = balls.mean(axis=1)
    return found


def test_a_row_is_shown_by_time_and_named(scene, cloud, points):
    assert labels_of(cloud) == list(LABELS)
    places = marker_positions(cloud, 13)  # four rows later: two rows of 120 Hz a frame
    assert list(places) == list(LABELS)
    assert np.abs(np.array(list(places.values())) - points[4]).max() < 1e-6
    assert "Anna:RFHD" not in marker_positions(cloud, 13.5)
    assert np.abs(np.sort(shown(scene, cloud, 13)[0], axis=0) - np.sort(points[4], axis=0)).max() < 1e-4
    set_played_rate(cloud, 1.0)
    assert np.abs(np.array(marker_positions(cloud, 14)["Anna:C7"]) - points[3, 2]).max() < 1e-6
    assert np.abs(np.array(marker_positions(cloud, 500)["Anna:C7"]) - points[-1, 2]).max() < 1e-6


def test_markers_take_the_colour_of_their_residual(scene, cloud, points, files):
    residual = np.array([[3.0, 12.0, 40.0]] * FRAMES)
    residual[2, 0] = np.nan
    motion = bare_motion(
        files.motion, FRAMES, marker_labels=("Anna:RFHD", "Anna:LFHD", "Anna:C7"), marker_residual_mm=residual,
        markers=points[:, [1, 0, 2]],
    )  # fmt: skip
    grade_markers(cloud, motion)
    found = shown(scene, cloud, 11)
    for colour, marker in ((0, 3), (1, 1), (2, 0), (3, 2)):
        assert np.abs(found[colour] - points[0, marker]).max() < 1e-4, colour
    assert sorted(shown(scene, cloud, 12)) == [0, 2, 3]  # where there is no residual, as recorded
    grade_markers(cloud, None)
    assert sorted(shown(scene, cloud, 11)) == [0]


def test_a_motion_of_other_length_colours_the_frames_it_has(cloud, files):
    motion = bare_motion(files.motion, 5, marker_labels=("Anna:C7",), marker_residual_mm=np.full((5, 1), 30.0))
    grade_markers(cloud, motion)
    grades = np.array([item.value for item in cloud.data.attributes["grade"].data]).reshape(FRAMES, -1)
    assert (grades[:5, 2] == 3).all() and not grades[5:].any() and not np.delete(grades, 2, axis=1).any()
