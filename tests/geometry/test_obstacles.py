"""Distances from planes, boxes and meshes, and the file that lists them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from solver_backend.exchange.errors import FileDamaged, FileMissing
from solver_backend.geometry.obstacles import Obstacles, read_obstacles

CUBE = """v -1 -1 0
v 1 -1 0
v 1 1 0
v -1 1 0
v -1 -1 2
v 1 -1 2
v 1 1 2
v -1 1 2
f 4 3 2 1
f 5/1 6/1 7/1 8/1
f 1 2 6 5
f 2 3 7 6
f 3 4 8 7
f 4 1 5 8
"""


def read(folder: Path, values: Any) -> Obstacles:
    (folder / "objects.json").write_text(json.dumps(values))
    return read_obstacles(folder / "objects.json")


def test_a_box_turned_by_a_right_angle(tmp_path: Path) -> None:
    world = read(tmp_path, {"boxes": [{"centre": [0, 0, 0.5], "size": [1, 2, 1], "turn_deg": 90}]})
    points = np.array([[0, 0, 0.9], [0, 0, 1.1], [1.1, 0, 0.5], [0.95, 0, 0.5], [1.3, 0.9, 1.4], [3, 3, 2.0]])
    distance, normal = world.nearest(points, 0.7)
    np.testing.assert_allclose(distance, [-0.1, 0.1, 0.1, -0.05, np.sqrt(0.41), 2.0], atol=1e-9)
    np.testing.assert_allclose(normal[[0, 1, 5]], np.tile([0.0, 0.0, 1.0], (3, 1)), atol=1e-9)
    np.testing.assert_allclose(normal[[2, 3]], np.tile([1.0, 0.0, 0.0], (2, 1)), atol=1e-9)


def test_a_mesh_equals_the_box_of_its_corners(tmp_path: Path) -> None:
    (tmp_path / "cube.obj").write_text(CUBE)
    mesh = read(tmp_path, {"meshes": ["cube.obj"]})
    box = read(tmp_path, {"boxes": [{"centre": [0, 0, 1], "size": [2, 2, 2]}]})
    points = np.random.default_rng(0).uniform([-1.5, -1.5, 0.0], [1.5, 1.5, 2.5], size=(50, 40, 3))
    for one, other in zip(mesh.nearest(points, 0.6), box.nearest(points, 0.6), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-9)


def test_a_plane_faces_free_space(tmp_path: Path) -> None:
    world = read(tmp_path, {"planes": [{"point": [2, 0, 0], "normal": [-3, 0, 0]}]})
    distance, normal = world.nearest(np.array([[1.5, 0, 1.0], [2.2, 0, 1.0]]), 0.1)
    np.testing.assert_allclose(distance, [0.5, -0.2])
    np.testing.assert_allclose(normal, [[-1, 0, 0], [-1, 0, 0]])
    assert world.has_objects and not Obstacles.floor().has_objects


@pytest.mark.parametrize(
    "values",
    [
        [], {"spheres": []}, {"boxes": {}}, {"boxes": [3]}, {"boxes": [{"centre": [0, 0, 0], "size": [1, 0, 1]}]},
        {"boxes": [{"centre": [0, 0], "size": [1, 1, 1]}]}, {"planes": [{"point": [0, 0, 0], "normal": [0, 0, 0]}]},
        {"planes": [{"point": [0, 0, "a"], "normal": [0, 0, 1]}]}, {"meshes": ["bad.obj"]},
        {"boxes": [{"centre": [0, 0, 0], "size": [1, 1, 1], "turn_deg": "x"}]},
    ],
)  # fmt: skip
def test_damaged_files_are_refused(tmp_path: Path, values: Any) -> None:
    (tmp_path / "bad.obj").write_text("v 0 0 0\nf 1 2 9\n")
    with pytest.raises(FileDamaged):
        read(tmp_path, values)


def test_a_missing_mesh_is_named(tmp_path: Path) -> None:
    with pytest.raises(FileMissing):
        read(tmp_path, {"meshes": ["chair.obj"]})


def test_a_mesh_with_its_faces_turned_in_is_the_same(tmp_path: Path) -> None:
    faces = [line.split() for line in CUBE.splitlines() if line.startswith("f")]
    turned = [line for line in CUBE.splitlines() if line.startswith("v")] + [" ".join(["f", *f[:0:-1]]) for f in faces]
    points = np.array([[0.0, 0.0, 2.1], [0.0, 0.0, 1.9], [0.9, 0.2, 1.0]])
    found = []
    for lines in (CUBE, "\n".join(turned)):
        (tmp_path / "cube.obj").write_text(lines)
        found.append(read(tmp_path, {"meshes": ["cube.obj"]}).without_floor.nearest(points, 0.5)[0])
    np.testing.assert_allclose(found, np.tile([0.1, -0.1, -0.1], (2, 1)), atol=1e-9)


def test_a_concave_face_is_refused(tmp_path: Path) -> None:
    outline = [(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)]
    rows = [f"v {x} {y} {z}" for z in (0, 1) for x, y in outline]
    rows += ["f 5 4 3 2 1 6", "f 8 9 10 11 12 7"]
    (tmp_path / "corner.obj").write_text("\n".join(rows))
    with pytest.raises(FileDamaged, match="is concave"):
        read(tmp_path, {"meshes": ["corner.obj"]})


@pytest.mark.parametrize("face", ["f 4 1 5 8", "f 4 3 2 1"])
def test_a_mesh_with_a_hole_or_a_flipped_face_is_refused(tmp_path: Path, face: str) -> None:
    other = "" if face == "f 4 1 5 8" else "f 1 2 3 4"
    (tmp_path / "cube.obj").write_text(CUBE.replace(face, other))
    with pytest.raises(FileDamaged, match="not closed"):
        read(tmp_path, {"meshes": ["cube.obj"]})
