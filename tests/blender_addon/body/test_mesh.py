"""The skin carries the body's weights, materials and texture."""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np

from blender_addon.body.armature import deform_bone
from blender_addon.body.rig import Rig
from blender_addon.conventions.skeleton import JOINTS
from blender_addon.scene.bake import BakedTake


def test_no_polygon_crosses_a_seam_of_the_texture(rig: Rig) -> None:
    """A texture would be smeared over the polygon. The map has no overlaps, so its area is below 1."""
    data = rig.mesh.data
    uv, places = (np.array([list(getattr(item, name)) for item in items]) for items, name in (
        (data.uv_layers[0].data, "uv"), (data.vertices, "co"),
    ))  # fmt: skip
    area, surface = np.array([
        (_area(np.c_[uv[list(p.loop_indices)], np.zeros(len(p.vertices))]), _area(places[list(p.vertices)]))
        for p in data.polygons
    ]).T  # fmt: skip
    assert 0.3 < area.sum() < 1.0
    stretch = np.sqrt(area / surface)
    assert stretch.max() < 3.0 * np.median(stretch)


def _area(corners: np.ndarray) -> float:
    return 0.5 * float(np.linalg.norm(np.cross(corners[1:-1] - corners[0], corners[2:] - corners[0]).sum(axis=0)))


def test_mesh_carries_groups_materials_and_texture(take: BakedTake, files: Any) -> None:
    mesh = take.mesh
    assert [group.name for group in mesh.vertex_groups] == [deform_bone(joint) for joint in JOINTS]
    weights = np.zeros_like(files.body.weights)
    for vertex in mesh.data.vertices:
        for group in vertex.groups:
            weights[vertex.index, group.group] = group.weight
    np.testing.assert_allclose(weights, files.body.weights, atol=1e-6)
    triangles = zip(files.body.faces.tolist(), files.body.face_material.tolist(), strict=True)
    corners = {frozenset(face): material for face, material in triangles}
    for polygon in mesh.data.polygons:
        halves = [half for half in combinations(polygon.vertices, 3) if frozenset(half) in corners]
        assert len(halves) == len(polygon.vertices) - 2
        assert {corners[frozenset(half)] for half in halves} == {polygon.material_index}
    assert len(mesh.data.materials) == 2
    corner = np.array([loop.vertex_index for loop in mesh.data.loops])
    uv = np.array([item.uv for item in mesh.data.uv_layers[0].data])
    np.testing.assert_allclose(uv, files.body.v_template[corner, :2] / 2, atol=1e-6)
    assert [modifier.type for modifier in mesh.modifiers] == ["NODES", "ARMATURE"], "correctives come before bones"
    assert mesh.modifiers[1].object is take.armature and not mesh.modifiers[1].use_deform_preserve_volume
