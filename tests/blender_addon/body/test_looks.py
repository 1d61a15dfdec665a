"""A body has five looks, every face has a material in each, and going back loses nothing."""

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
from blender_addon.body.body_file import BodyFile, default_body_path, read_body
from blender_addon.body.looks import looks_of, show_look
from blender_addon.body.rig import Rig, create_rig
from blender_addon.conventions.naming import (
    LOOKS,
    MANNEQUIN,
    PERSON_LOOK,
    SEGMENTS,
    SEGMENTS_LOOK,
    SHAVEN_LOOK,
    SUIT_LOOK,
)
from blender_addon.export.plain_take import plain_copy
from solver_backend.body.body import load_body
from tests.support.looks import look_of, shown_colours, used_slots


def skin(mesh: bpy.types.Object) -> np.ndarray:
    """Return the (V, 3) evaluated vertices."""
    bpy.context.view_layer.update()
    found = mesh.evaluated_get(bpy.context.evaluated_depsgraph_get())
    return np.array([vertex.co for vertex in found.data.vertices])


def test_a_new_body_is_the_solvers_skin_in_a_suit(rig: Rig) -> None:
    assert look_of(rig.mesh) == "plain" and len(shown_colours(rig.mesh)) == 8
    before = skin(rig.mesh)
    show_look(rig.mesh, SUIT_LOOK)
    np.testing.assert_array_equal(skin(rig.mesh), before)


def test_a_mannequin_has_no_face(rig: Rig, body: BodyFile) -> None:
    suit = skin(rig.mesh)
    show_look(rig.mesh, MANNEQUIN)
    assert look_of(rig.mesh) == MANNEQUIN and len(shown_colours(rig.mesh)) == 2
    moved = np.linalg.norm(skin(rig.mesh) - suit, axis=1)
    assert body.blank_face is not None and moved[body.blank_face[0]].max() > 0.015, "the nose and the ears go"


def test_shoes_cover_the_toenails(body: BodyFile) -> None:
    assert body.face_material is not None
    nails = (body.face_material == 6) & (body.v_template[body.faces][:, :, 1].max(axis=1) < -0.9)
    assert nails.any() and set(body.looks[PERSON_LOOK][0][nails]) <= {13, 14}


def test_clothes_stand_off_the_body_and_soles_stay_on_the_floor(rig: Rig, body: BodyFile) -> None:
    suit = skin(rig.mesh)
    show_look(rig.mesh, PERSON_LOOK)
    dressed = skin(rig.mesh)
    names = {rig.mesh.material_slots[k].material.name for k in used_slots(rig.mesh)}
    assert {"Skin", "Hair", "Nail", "Shirt", "Shorts", "Shoe"} <= names and "Suit" not in names
    grown = volume(dressed, body.faces) / volume(suit, body.faces)
    assert 1.02 < grown < 1.12
    assert abs(dressed[:, 2].min() - suit[:, 2].min()) < 1e-4
    assert 0.005 < dressed[:, 2].max() - suit[:, 2].max() < 0.02, "hair on the head"


def volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return float(np.einsum("fa,fa->", a, np.cross(b, c))) / 6.0


def test_segments_differ_in_colour_and_lie_at_their_joints(rig: Rig, body: BodyFile) -> None:
    show_look(rig.mesh, SEGMENTS_LOOK)
    assert look_of(rig.mesh) == SEGMENTS_LOOK and len(shown_colours(rig.mesh)) == len(SEGMENTS)
    rest = body.v_template + body.looks[SEGMENTS_LOOK][1]
    joints = dict(zip(body.layout.joints, body.J_regressor @ body.v_template, strict=True))
    for segment, joint, end in (
        ("Left Forearm", "left_elbow", "left_wrist"),
        ("Right Shank", "right_knee", "right_ankle"),
    ):
        own = np.unique(body.faces[body.looks[SEGMENTS_LOOK][0] == SEGMENTS.index(segment)])
        bone = joints[end] - joints[joint]
        along = (rest[own] - joints[joint]) @ bone / (bone @ bone)
        assert -0.05 < along.min() < 0.05 and 0.92 < along.max() < 1.08


def test_every_look_has_a_material_for_every_face(rig: Rig) -> None:
    for look in LOOKS:
        show_look(rig.mesh, look)
        slots = rig.mesh.material_slots
        assert all(slots[k].material is not None for k in used_slots(rig.mesh)), look
        assert len(slots) == len(used_slots(rig.mesh)), "slots of other looks are not in the list"
    made = set(bpy.data.materials)
    for look in LOOKS:
        show_look(rig.mesh, look)
    assert set(bpy.data.materials) == made, "materials of a look are made once"
    assert all(material.users for material in made)


def test_hems_are_lines(body: BodyFile) -> None:
    """The edges between shorts and skin lie at one height per side, where the mesh has edges of 26 mm."""
    material, offsets = body.looks[PERSON_LOOK]
    rest = body.v_template + offsets
    cloth, bare = (np.unique(body.faces[material == kind]) for kind in (11, 0))
    hem = np.intersect1d(cloth, bare)
    left = rest[hem][(rest[hem, 0] > 0) & (rest[hem, 1] < -0.2)]
    plane = np.linalg.lstsq(np.c_[left[:, [0, 2]], np.ones(len(left))], left[:, 1], rcond=None)[0]
    off = left[:, 1] - np.c_[left[:, [0, 2]], np.ones(len(left))] @ plane
    assert len(left) > 15 and np.abs(off).max() < 0.003


def test_a_shaven_head_differs_from_athletic_wear_only_on_the_scalp(body: BodyFile) -> None:
    (haired, with_hair), (shaven, without) = body.looks[PERSON_LOOK], body.looks[SHAVEN_LOOK]
    scalp = haired != shaven
    assert scalp.sum() > 300 and set(haired[scalp]) == {8} and set(shaven[scalp]) == {0}
    assert (shaven == 8).any(), "the brows stay"
    grown = np.linalg.norm(with_hair - without, axis=1)
    assert set(np.flatnonzero(grown > 1e-6)) <= set(np.unique(body.faces[scalp]))
    assert 0.013 < grown.max() < 0.015, "hair is 14 mm thick"


def test_looks_are_mirror_images(body: BodyFile) -> None:
    with np.load(default_body_path()) as data:
        mirror = data["mirror"].astype(int)
    for look, (_, offsets) in body.looks.items():
        dressed = body.v_template + offsets
        apart = np.linalg.norm(dressed[mirror] * [-1.0, 1.0, 1.0] - dressed, axis=1)
        assert apart.max() < 2e-4, look


def test_a_look_is_kept_by_a_file(rig: Rig, tmp_path: Path) -> None:
    wanted = {}
    for look in (PERSON_LOOK, SEGMENTS_LOOK):
        show_look(rig.mesh, look)
        wanted[look] = skin(rig.mesh), shown_colours(rig.mesh)
    name = rig.mesh.name
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "look.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "look.blend"))
    for look in (SEGMENTS_LOOK, PERSON_LOOK):
        mesh = bpy.data.objects[name]
        show_look(mesh, look)
        np.testing.assert_allclose(skin(mesh), wanted[look][0], atol=1e-6)
        assert shown_colours(mesh) == wanted[look][1]


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
    rig.mesh.data.polygons[0].material_index = 1
    show_look(rig.mesh, MANNEQUIN)
    grey = rig.mesh.data.polygons[0].material_index
    plain = bpy.data.materials.new("My Grey")
    rig.mesh.material_slots[grey].material = plain
    show_look(rig.mesh, SUIT_LOOK)
    assert rig.mesh.material_slots[1].material is own and rig.mesh.data.polygons[0].material_index == 1
    np.testing.assert_array_equal(skin(rig.mesh), before)
    show_look(rig.mesh, MANNEQUIN)
    assert rig.mesh.material_slots[rig.mesh.data.polygons[0].material_index].material is plain
    show_look(rig.mesh, MANNEQUIN)
    assert len([m for m in bpy.data.materials if m.name.startswith("Mannequin")]) == 1


def test_a_shown_look_that_is_shown_again_keeps_the_materials_of_faces(rig: Rig) -> None:
    show_look(rig.mesh, MANNEQUIN)
    show_look(rig.mesh, SUIT_LOOK)
    rig.mesh.data.materials.append(bpy.data.materials.new("Tape"))
    face, tape = rig.mesh.data.polygons[0], len(rig.mesh.data.materials) - 1
    face.material_index = tape
    show_look(rig.mesh, SUIT_LOOK)
    assert face.material_index == tape
    show_look(rig.mesh, MANNEQUIN)
    show_look(rig.mesh, SUIT_LOOK)
    assert rig.mesh.data.polygons[0].material_index == tape


def names_of_faces(mesh: bpy.types.Object) -> list[str]:
    """Return the name of each polygon's material."""
    return [mesh.data.materials[face.material_index].name for face in mesh.data.polygons]


@pytest.mark.parametrize("shown", [SUIT_LOOK, MANNEQUIN])
def test_looks_survive_removed_and_moved_slots(rig: Rig, shown: str) -> None:
    wanted = {}
    for look in LOOKS:
        show_look(rig.mesh, look)
        rig.mesh.data.materials[rig.mesh.data.polygons[7].material_index] = bpy.data.materials.new(f"Mine {look}")
        wanted[look] = names_of_faces(rig.mesh)
    for look in LOOKS:  # which share materials
        show_look(rig.mesh, look)
        wanted[look] = names_of_faces(rig.mesh)
    show_look(rig.mesh, shown)
    bpy.context.view_layer.objects.active = rig.mesh
    rig.mesh.select_set(True)
    bpy.ops.object.material_slot_remove_unused()
    assert len(rig.mesh.material_slots) == len(used_slots(rig.mesh))
    rig.mesh.active_material_index = 0
    bpy.ops.object.material_slot_move(direction="DOWN")
    for look in (*LOOKS, *LOOKS):
        show_look(rig.mesh, look)
        assert names_of_faces(rig.mesh) == wanted[look], look


def test_looks_keep_their_own_slots(rig: Rig) -> None:
    """Slots that the user adds, empties or repeats stay in the look, and the materials of an object stay its own."""
    show_look(rig.mesh, PERSON_LOOK)
    data, own = rig.mesh.data, bpy.data.materials.new("Mine")
    for material in (None, own, own):
        data.materials.append(material)
    data.polygons[5].material_index = len(data.materials) - 1
    rig.mesh.material_slots[2].link, rig.mesh.material_slots[2].material = "OBJECT", own
    before = [(slot.link, slot.material) for slot in rig.mesh.material_slots]
    show_look(rig.mesh, MANNEQUIN)
    assert own not in list(data.materials) and {slot.link for slot in rig.mesh.material_slots} == {"DATA"}
    data.materials.pop(index=0)
    grey = list(data.materials)
    show_look(rig.mesh, PERSON_LOOK)
    assert [(slot.link, slot.material) for slot in rig.mesh.material_slots] == before
    assert data.polygons[5].material_index == len(before) - 1
    show_look(rig.mesh, MANNEQUIN)
    assert list(data.materials) == grey


def test_objects_of_one_mesh_keep_their_own_materials(scene: Any, rig: Rig, tmp_path: Path) -> None:
    """A look is the mesh's. A material of an object returns with the look, also from a file and on a copy."""
    two = rig.mesh.copy()
    scene.collection.objects.link(two)
    for mesh, k in ((two, 1), (two, 3), (rig.mesh, 3)):
        own = None if mesh is rig.mesh else bpy.data.materials.new(f"Own {k}")
        mesh.material_slots[k].link, mesh.material_slots[k].material = "OBJECT", own
    names = rig.mesh.name, two.name

    def slots() -> list[list[tuple[str, str]]]:
        meshes = map(bpy.data.objects.get, names)
        return [[(slot.link, slot.material.name if slot.material else "") for slot in m.material_slots] for m in meshes]

    before = slots()
    under = list(rig.mesh.data.materials)
    for mesh in (rig.mesh, two):
        show_look(mesh, MANNEQUIN)
    assert {link for found in slots() for link, _ in found} == {"DATA"}
    show_look(two, SUIT_LOOK)
    assert slots() == before and list(rig.mesh.data.materials) == under
    show_look(rig.mesh, MANNEQUIN)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "two.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "two.blend"))
    show_look(bpy.data.objects[names[0]], SUIT_LOOK)
    assert slots() == before


def test_an_overridden_mesh_keeps_its_saved_look(rig: Rig, tmp_path: Path) -> None:
    """A file does not keep the slots of an overridden mesh, but it would keep the name of the look."""
    name = rig.mesh.name
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "library.blend"))
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    with bpy.data.libraries.load(str(tmp_path / "library.blend"), link=True) as (_, wanted):
        wanted.objects = [name]
    mesh = wanted.objects[0].override_create()
    bpy.context.scene.collection.objects.link(mesh)
    mesh.data = mesh.data.override_create()
    before = [slot.material for slot in mesh.material_slots]
    show_look(mesh, MANNEQUIN)
    assert not looks_of(mesh) and [slot.material for slot in mesh.material_slots] == before


def test_a_look_without_its_attribute_is_left_and_not_shown(rig: Rig) -> None:
    show_look(rig.mesh, MANNEQUIN)
    rig.mesh.data.attributes.remove(rig.mesh.data.attributes["look_mannequin"])
    show_look(rig.mesh, PERSON_LOOK)
    assert look_of(rig.mesh) == PERSON_LOOK
    before = skin(rig.mesh)
    show_look(rig.mesh, MANNEQUIN)
    assert look_of(rig.mesh) == PERSON_LOOK
    np.testing.assert_array_equal(skin(rig.mesh), before)


def test_a_plain_copy_has_the_materials_of_the_object(scene: Any, rig: Rig) -> None:
    show_look(rig.mesh, MANNEQUIN)
    own = [bpy.data.materials.new(f"Own {k}") for k in range(len(rig.mesh.material_slots))]
    for slot, material in list(zip(rig.mesh.material_slots, own, strict=True))[1::2]:
        slot.link, slot.material = "OBJECT", material
    wanted = [rig.mesh.material_slots[face.material_index].material for face in rig.mesh.data.polygons]
    _, copy = plain_copy(rig.armature, rig.mesh, scene.collection)
    assert [copy.material_slots[face.material_index].material for face in copy.data.polygons] == wanted
    assert [slot.link for slot in rig.mesh.material_slots[:2]] == ["DATA", "OBJECT"]


def test_a_shape_is_kept_and_a_plain_copy_looks_the_same(scene: Any, rig: Rig) -> None:
    show_look(rig.mesh, MANNEQUIN)
    rig.mesh.data.shape_keys.key_blocks[1].value = 1.5
    wanted = skin(rig.mesh)
    _, copy = plain_copy(rig.armature, rig.mesh, scene.collection)
    np.testing.assert_allclose([v.co for v in copy.data.vertices], wanted, atol=2e-4)
    assert shown_colours(copy) == shown_colours(rig.mesh) and len(copy.material_slots) == 2


def test_a_body_without_the_look_changes_its_colours_alone(scene: Any, files: Any) -> None:
    mesh = create_rig("Other", files.body, np.zeros(10), scene.collection).mesh
    before = skin(mesh)
    show_look(mesh, SEGMENTS_LOOK)
    assert len(shown_colours(mesh)) > 12
    show_look(mesh, MANNEQUIN)
    assert look_of(mesh) == MANNEQUIN and len(shown_colours(mesh)) == 1
    np.testing.assert_array_equal(skin(mesh), before)


@pytest.mark.parametrize(
    ("vertices", "offsets", "words"),
    [
        (np.array([10**6]), np.zeros((1, 3)), "blank_vertices must refer to vertices"),
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


def materials_of_glb(path: Path) -> dict[str, list[float]]:
    """Return the base colours of a file by material."""
    data = path.read_bytes()
    [length] = struct.unpack_from("<I", data, 12)
    found = json.loads(data[20 : 20 + length])["materials"]
    return {item["name"]: item["pbrMetallicRoughness"].get("baseColorFactor", [1.0] * 4) for item in found}


@pytest.mark.slow
def test_headless_verbs_take_the_look(files: Any, body: BodyFile, tmp_path: Path) -> None:
    assert main(["body", "--out", str(tmp_path / "Body.blend"), "--look", "mannequin"]) == 0
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "Body.blend"), load_ui=False)
    [mesh] = [obj for obj in bpy.data.objects if obj.type == "MESH" and obj.data.shape_keys]
    assert look_of(mesh) == MANNEQUIN
    for look in LOOKS:
        out = ["export", str(files.motion_path), "--format", "gltf", "--out", str(tmp_path / look), "--look", look]
        assert main([*out, "--body", str(files.body_path)]) == 0
    found = {look: materials_of_glb(tmp_path / look / "walk.glb") for look in LOOKS}
    assert set(found[MANNEQUIN]) == {"Mannequin"} and "Suit" in found[PERSON_LOOK]
    np.testing.assert_allclose(found[MANNEQUIN]["Mannequin"], [0.55, 0.56, 0.58, 1.0], atol=1e-3)
    assert len(found[SEGMENTS_LOOK]) > 12
    picture = ["bake", str(files.motion_path), "--out", str(tmp_path / "baked"), "--body", str(files.body_path)]
    assert main([*picture, "--no-pictures", "--look", "mannequin"]) == 0
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "baked" / "walk.blend"), load_ui=False)
    assert [look_of(o) for o in bpy.data.objects if o.type == "MESH" and o.data.shape_keys] == [MANNEQUIN]
