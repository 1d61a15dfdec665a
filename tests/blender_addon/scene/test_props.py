"""Props in Blender: empties that move as they do, with their markers as a mesh."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import bpy
import numpy as np
import pytest

from blender_addon._exchange.props import Prop
from blender_addon.scene.bake import BakeSettings, add_take, bake_take
from blender_addon.scene.props import MARKERS, SIGMA_DEG, SIGMA_MM


def a_prop(frames: int) -> Prop:
    rng = np.random.default_rng(2)
    sigma = rng.uniform(1e-3, 2e-3, (frames, 2))
    return Prop(
        "Racket", ("a", "b", "c", "d"), rng.normal(size=(4, 3)), rng.normal(size=(frames, 3)),
        rng.normal(size=(frames, 3)), sigma, np.full(frames, 4, np.uint8),
    )  # fmt: skip


@pytest.mark.parametrize("scale", [1.0, 0.01])
def test_the_mesh_of_an_empty_is_where_the_markers_are(scene: bpy.types.Scene, files: Any, scale: float) -> None:
    prop = a_prop(files.motion.num_frames)
    scene.unit_settings.scale_length = scale
    take = bake_take(scene, replace(files.motion, props=(prop,)), files.body, settings=BakeSettings(frame_start=5))
    (empty,) = take.props
    (mesh,) = empty.children
    assert (empty.name, empty.type, mesh[MARKERS].split("\n")) == ("Racket", "EMPTY", list(prop.labels))
    assert len(mesh.data.edges) == 6
    for frame in (0, 17, 59):
        scene.frame_set(5 + frame)
        world = np.array(mesh.matrix_world)
        points = np.array([vertex.co for vertex in mesh.data.vertices]) @ world[:3, :3].T + world[:3, 3]
        np.testing.assert_allclose(scale * points, prop.markers[frame], atol=2e-5)
        assert empty[SIGMA_MM] == pytest.approx(1000 * prop.sigma[frame, 0], rel=1e-4)
        assert empty[SIGMA_DEG] == pytest.approx(np.degrees(prop.sigma[frame, 1]), rel=1e-4)


def test_a_second_take_brings_its_props_too(scene: bpy.types.Scene, files: Any) -> None:
    first = bake_take(scene, files.motion, files.body)
    assert first.props == ()
    motion = replace(files.motion, props=(a_prop(files.motion.num_frames),))
    add_take(scene, "second", motion, files.body, first.armature, None, 1)
    assert [obj.name for obj in scene.objects if obj.type == "EMPTY" and SIGMA_MM in obj] == ["Racket"]
