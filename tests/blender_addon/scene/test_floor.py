"""The floor under a way: metre tiles, and of a long way few tiles of more metres."""

from __future__ import annotations

import bpy
import numpy as np
import pytest

from blender_addon.scene.capture_stage import create_floor


@pytest.mark.parametrize(("way_m", "tiles"), [(3.0, 7), (20_000.0, 200)])
def test_a_floor_lies_under_the_whole_way(scene: bpy.types.Scene, way_m: float, tiles: int) -> None:
    floor = create_floor(np.array([[0.0, 0.0, 1.0], [way_m, 0.0, 1.0]]), scene.collection)
    places = np.array([vertex.co[:] for vertex in floor.data.vertices])
    assert places[:, 0].min() < 0 and places[:, 0].max() > way_m
    assert len(np.unique(places[:, 0].round(2))) <= 2 * (tiles + 2) and len(places) < 170_000
