"""A body looks like a person or like a mannequin, and going back loses nothing."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest

from blender_addon.__main__ import main
from blender_addon._exchange.errors import BodyInvalid
from blender_addon.body.body_file import BodyFile, read_body
from blender_addon.body.rig import Rig, create_rig
from blender_addon.body.shape import show_look
from blender_addon.conventions.naming import LOOKS, MANNEQUIN, PERSON_LOOK
from blender_addon.export.plain_take import plain_copy
from solver_backend.body.body import load_body
from tests.support.looks import look_of


def skin(mesh: bpy.types.Object) -> np.ndarray:
    """Return the (V, 3) evaluated vertices."""
    bpy.context.view_layer.update()
    found = mesh.evaluated_get(bpy.context.evaluated_depsgraph_get())
    return np.array([vertex.co for vertex in found.data.vertices])


def colours(mesh: bpy.types.Object) -> set[tuple[float, ...]]:
    return {tuple(round(c, 3) for c in slot.material.diffuse_color) for slot in mesh.material_slots}


def test_a_mannequin_has_one_colour_and_no_face(rig: Rig, body: BodyFile) -> None:
    person = skin(rig.mesh)
    assert look_of(rig.mesh) == PERSON_LOOK and len(colours(rig.mesh)) == 8
    show_look(rig.mesh, MANNEQUIN)
    blank = skin(rig.mesh)
    assert look_of(rig.mesh) == MANNEQUIN and len(colours(rig.mesh)) == 1
    moved = np.linalg.norm(blank - person, axis=1)
    assert body.blank_face is not None and set(np.flatnonzero(moved > 1e-5)) <= set(body.blank_face[0].tolist())
    assert moved.max() > 0.015, "the nose and the ears go"


def bumps(vertices: np.ndarray, faces: np.ndarray, chosen: np.ndarray) -> float:
    """Return the 99th percentile of the angle between normals of faces that meet on the chosen vertices, degrees."""
    inside = faces[np.isin(faces, chosen).all(axis=1)]
    a, b, c = (vertices[inside[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    edges = np.sort(np.concatenate([inside[:, [0, 1]], inside[:, [1, 2]], inside[:, [2, 0]]]), axis=1)
    owner = np.tile(np.arange(len(inside)), 3)
    order = np.lexsort(edges.T)
    edges, owner = edges[order], owner[order]
    same = np.flatnonzero((edges[1:] == edges[:-1]).all(axis=1))
    cosine = np.einsum("ea,ea->e", normal[owner[same]], normal[owner[same + 1]])
    return float(np.degrees(np.arccos(np.clip(np.quantile(cosine, 0.01), -1, 1))))


def test_the_blank_head_is_smooth(body: BodyFile) -> None:
    assert body.blank_face is not None
    vertices, offsets = body.blank_face
    blank = body.v_template.copy()
    blank[vertices] += offsets
    assert bumps(body.v_template, body.faces, vertices) > 60.0
    assert bumps(blank, body.faces, vertices) < 25.0
    mirrored = np.sort(np.abs(blank[vertices][:, 0]).round(5))
    assert np.allclose(mirrored[:-1:2][1:4], mirrored[1::2][1:4], atol=1e-3)


def test_the_solver_reads_the_same_body_but_for_relaxed_lids(body: BodyFile) -> None:
    moved = np.linalg.norm(np.asarray(load_body().v_template) - body.v_template, axis=1) > 1e-7
    assert body.face_material is not None
    eyes = body.v_template[np.unique(body.faces[np.isin(body.face_material, (3, 4, 5))])]
    near = np.linalg.norm(body.v_template[moved][:, None] - eyes, axis=2).min(axis=1)
    assert 0 < moved.sum() < 200 and near.max() < 0.012


def test_back_and_forth_keeps_what_the_user_made_of_either(rig: Rig) -> None:
    before = skin(rig.mesh)
    own = bpy.data.materials.new("My Suit")
    rig.mesh.data.materials[1] = own
    show_look(rig.mesh, MANNEQUIN)
    plain = bpy.data.materials.new("My Grey")
    rig.mesh.material_slots[0].material = plain
    show_look(rig.mesh, PERSON_LOOK)
    assert rig.mesh.material_slots[1].material is own and look_of(rig.mesh) == PERSON_LOOK
    np.testing.assert_array_equal(skin(rig.mesh), before)
    show_look(rig.mesh, MANNEQUIN)
    assert rig.mesh.material_slots[0].material is plain
    show_look(rig.mesh, MANNEQUIN)
    assert len([m for m in bpy.data.materials if m.name.startswith("Mannequin")]) == 1


def test_a_shape_is_kept_and_a_plain_copy_looks_the_same(scene: Any, rig: Rig) -> None:
    show_look(rig.mesh, MANNEQUIN)
    rig.mesh.data.shape_keys.key_blocks[1].value = 1.5
    wanted = skin(rig.mesh)
    _, copy = plain_copy(rig.armature, rig.mesh, scene.collection)
    np.testing.assert_allclose([v.co for v in copy.data.vertices], wanted, atol=2e-4)
    assert len(colours(copy)) == 1


def test_a_body_without_the_look_changes_its_colours_alone(scene: Any, files: Any) -> None:
    mesh = create_rig("Other", files.body, np.zeros(10), scene.collection).mesh
    before = skin(mesh)
    show_look(mesh, MANNEQUIN)
    assert look_of(mesh) == MANNEQUIN and len(colours(mesh)) == 1
    np.testing.assert_array_equal(skin(mesh), before)


@pytest.mark.parametrize(
    ("vertices", "offsets", "words"),
    [
        (np.array([10**6]), np.zeros((1, 3)), "blank_vertices must name vertices"),
        (np.array([1, 2]), np.zeros((1, 3)), "blank_offsets has shape"),
        (np.array([1]), np.full((1, 3), np.nan), "NaN"),
    ],
)
def test_a_damaged_look_is_refused(files: Any, tmp_path: Path, vertices: Any, offsets: Any, words: str) -> None:
    with np.load(files.body_path) as data:
        arrays = dict(data)
    np.savez(tmp_path / "body.npz", **arrays, blank_vertices=vertices, blank_offsets=offsets)
    with pytest.raises(BodyInvalid, match=words):
        read_body(tmp_path / "body.npz")


def materials_of_glb(path: Path) -> list[str]:
    data = path.read_bytes()
    [length] = struct.unpack_from("<I", data, 12)
    return [material["name"] for material in json.loads(data[20 : 20 + length])["materials"]]


@pytest.mark.slow
def test_headless_verbs_take_the_look(files: Any, body: BodyFile, tmp_path: Path) -> None:
    assert main(["body", "--out", str(tmp_path / "Body.blend"), "--look", "mannequin"]) == 0
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "Body.blend"), load_ui=False)
    [mesh] = [obj for obj in bpy.data.objects if obj.type == "MESH" and len(obj.material_slots) == 8]
    assert look_of(mesh) == MANNEQUIN
    for look in LOOKS:
        out = ["export", str(files.motion_path), "--format", "gltf", "--out", str(tmp_path / look), "--look", look]
        assert main([*out, "--body", str(files.body_path)]) == 0
    found = {look: materials_of_glb(tmp_path / look / "walk.glb") for look in LOOKS}
    assert found[MANNEQUIN] == ["Mannequin"] and "Suit" in found[PERSON_LOOK]
    picture = ["bake", str(files.motion_path), "--out", str(tmp_path / "baked"), "--body", str(files.body_path)]
    assert main([*picture, "--no-pictures", "--look", "mannequin"]) == 0
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "baked" / "walk.blend"), load_ui=False)
    assert [look_of(o) for o in bpy.data.objects if o.type == "MESH" and o.data.shape_keys] == [MANNEQUIN]
