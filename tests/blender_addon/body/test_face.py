"""The face: 52 shapes with ARKit's names that do what their names say, driven by received values and by keys."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from mathutils import Euler, Vector

from blender_addon._exchange.errors import BodyInvalid
from blender_addon.body.body_file import BodyFile, default_body_path, read_body
from blender_addon.body.face import add_face_bones, add_face_shapes, face_bones
from blender_addon.body.looks import show_look
from blender_addon.body.rig import Rig, create_rig
from blender_addon.body.shape import set_betas
from blender_addon.conventions.coordinates import R_ARMATURE_BODY
from blender_addon.conventions.naming import MANNEQUIN, PERSON_LOOK
from blender_addon.conventions.skeleton import SMPL_HANDS
from blender_addon.scene.live_figure import LiveFace
from solver_backend.body.body import load_body
from solver_backend.live.face_source import BLEND_SHAPES

SKIN, LIPS, PUPIL, MOUTH = 0, 2, 5, 7  # Materials.


@pytest.fixture
def face(rig: Rig, body: BodyFile) -> bpy.types.Object:
    assert add_face_shapes(rig.mesh, body) == 52
    return rig.mesh


def moved(body: BodyFile, **values: float) -> np.ndarray:
    """Return the (V, 3) rest skin with shapes of the face, in the body's frame."""
    vertices = body.v_template.copy()
    for name, value in values.items():
        at, offsets = body.face_shapes[name]
        vertices[at] += value * offsets
    return vertices


def seen_ahead(body: BodyFile, vertices: np.ndarray, at: np.ndarray) -> int:
    """Return the material that a viewer in front of the face sees at (x, y)."""
    from mathutils.bvhtree import BVHTree

    tree = BVHTree.FromPolygons(vertices.tolist(), body.faces.tolist(), all_triangles=True)
    face = tree.ray_cast(Vector((*at[:2], 1.0)), Vector((0.0, 0.0, -1.0)))[2]
    assert body.face_material is not None and face is not None
    return int(body.face_material[face])


def places(body: BodyFile) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the middle of the left pupil, of the lips' seam, and the vertices of the seam."""
    assert body.face_material is not None
    pupil = np.unique(body.faces[body.face_material == PUPIL])
    pupil = pupil[body.v_template[pupil, 0] > 0]
    inside, lips = (np.unique(body.faces[body.face_material == material]) for material in (MOUTH, LIPS))
    seam = np.setdiff1d(inside, lips)
    return body.v_template[pupil].mean(axis=0), body.v_template[seam].mean(axis=0), seam


def test_the_names_are_arkits_and_both_sides_mirror(body: BodyFile) -> None:
    assert tuple(body.face_shapes) == BLEND_SHAPES
    flip = np.array([-1.0, 1.0, 1.0])
    for name in BLEND_SHAPES:
        at, offsets = body.face_shapes[name]
        assert len(at) and 1e-3 < np.linalg.norm(offsets, axis=1).max() < 0.045, name
        if name.endswith("Left"):
            other, offsets_there = body.face_shapes[name.removesuffix("Left") + "Right"]
            here = np.c_[body.v_template[at] * flip, offsets * flip].round(5)
            there = np.c_[body.v_template[other], offsets_there].round(5)
            np.testing.assert_allclose(np.sort(here, axis=0), np.sort(there, axis=0), atol=3e-5, err_msg=name)


@pytest.mark.parametrize("amount", [0.5, 1.0])
def test_a_blink_covers_the_pupil_and_no_eyeball_comes_through_the_lid(body: BodyFile, amount: float) -> None:
    pupil, _, _ = places(body)
    assert seen_ahead(body, body.v_template, pupil) == PUPIL
    closed = moved(body, eyeBlinkLeft=amount)
    across, above = np.linspace(-0.006, 0.006, 7), (0.003, 0.0045, 0.006)
    assert {seen_ahead(body, closed, pupil + [x, y, 0.0]) for x in across for y in above} == {SKIN}
    if amount == 1.0:
        lower = np.linspace(-0.005, 0.003, 9)
        assert {seen_ahead(body, closed, pupil + [x, y, 0.0]) for x in across for y in lower} == {SKIN}
        assert seen_ahead(body, closed, pupil * [-1.0, 1.0, 1.0]) == PUPIL, "the other eye stays open"


def test_an_eye_at_rest_is_relaxed(body: BodyFile) -> None:
    stored = np.asarray(load_body().v_template)
    change = np.linalg.norm(body.v_template - stored, axis=1)
    assert 1e-3 < change.max() < 2.5e-3
    np.testing.assert_allclose(body.rest_joints(np.zeros(10)), body.J_regressor @ stored, atol=1e-6)


@pytest.mark.parametrize(("look", "way"), [("In", (-1, 0)), ("Out", (1, 0)), ("Up", (0, 1)), ("Down", (0, -1))])
def test_eyes_turn(body: BodyFile, look: str, way: tuple[int, int]) -> None:
    pupil, _, _ = places(body)
    turned = moved(body, **{f"eyeLook{look}Left": 1.0})
    assert body.face_material is not None
    left = np.unique(body.faces[body.face_material == PUPIL])
    left = left[body.v_template[left, 0] > 0]
    step = (turned[left].mean(axis=0) - pupil)[:2]
    assert step @ np.array(way) > 0.0018 and abs(step @ np.array(way[::-1])) < 3e-4
    assert seen_ahead(body, turned, pupil + [*step, 0.0]) == PUPIL


def test_the_mouth_opens_and_closes_over_an_open_jaw(body: BodyFile) -> None:
    _, mouth, seam = places(body)
    assert seen_ahead(body, body.v_template, mouth + [0.0, -0.004, 0.0]) == LIPS
    wide = moved(body, jawOpen=1.0)
    assert {seen_ahead(body, wide, mouth + [x, -0.012, 0.0]) for x in (-0.006, 0.0, 0.006)} == {MOUTH}
    assert (wide - body.v_template)[seam, 2].min() < -0.01, "it is hollow"
    near = np.abs(body.v_template[:, 0]) < 0.01
    nose = near & (body.v_template[:, 1] > mouth[1] + 0.02)
    assert np.abs((wide - body.v_template)[nose]).max() < 1e-4
    closed = moved(body, jawOpen=1.0, mouthClose=1.0)
    assert seen_ahead(body, closed, mouth + [0.0, -0.004, 0.0]) == LIPS
    assert (wide - body.v_template)[:, 1].min() < -0.02 and (closed - body.v_template)[:, 1].min() < -0.015


def test_a_received_face_and_keys_drive_the_skin(face: bpy.types.Object, scene: bpy.types.Scene) -> None:
    rest = evaluated(face)
    assert LiveFace(face.name).show({"JawOpen": 0.6, "EyeBlinkLeft": 1.0, "HeadYaw": 0.3}) == 2
    assert np.linalg.norm(evaluated(face) - rest, axis=1).max() > 0.012
    block = face.data.shape_keys.key_blocks["mouthSmileLeft"]
    for frame, value in ((1, 0.0), (11, 1.0)):
        block.value = value
        block.keyframe_insert("value", frame=frame)
    scene.frame_set(6)
    assert 0.2 < block.value < 0.8


BONES = ("jaw", "left_eye", "left_eyelid", "right_eye", "right_eyelid")


def posed(rig: Rig, name: str, degrees: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> np.ndarray:
    """Return the evaluated skin with a bone of the face turned about its own axes."""
    rig.armature.pose.bones[name].rotation_quaternion = Euler(np.deg2rad(degrees)).to_quaternion()
    return evaluated(rig.mesh)


@pytest.mark.parametrize("when", ["before", "after"])
def test_bones_move_the_skin_of_any_shape_as_the_shapes_do(rig: Rig, body: BodyFile, when: str) -> None:
    betas = np.linspace(2.0, -2.0, 10)
    if when == "before":
        set_betas(rig.mesh, betas)
    rest = evaluated(rig.mesh)
    add_face_bones(rig.armature, rig.mesh, body)
    add_face_bones(rig.armature, rig.mesh, body)
    assert sorted(face_bones(rig.armature)) == list(BONES)
    np.testing.assert_allclose(evaluated(rig.mesh), rest, atol=2e-6)
    if when == "after":
        set_betas(rig.mesh, betas)
    rig.armature.pose.bones["head"].rotation_quaternion = (0.9, 0.1, 0.4, -0.1)
    rest = evaluated(rig.mesh)
    turn = np.array(rig.armature.pose.bones["head"].matrix.to_3x3()) @ np.array(
        rig.armature.data.bones["head"].matrix_local.to_3x3().inverted()
    )
    for name, degrees, shape, most in (
        ("jaw", (19.0, 0.0, 0.0), "jawOpen", 0.2),
        ("left_eyelid", (24.4, 0.0, 0.0), "eyeBlinkLeft", 0.3),
        ("right_eye", (0.0, -25.0, 0.0), "eyeLookOutRight", 0.3),
    ):
        moved = posed(rig, name, degrees) - rest
        at, offsets = body.face_shapes[shape]
        wanted = np.zeros_like(rest)
        wanted[at] = offsets @ R_ARMATURE_BODY.T @ turn.T
        if name.endswith("lid"):
            wanted[body.v_template[:, 1] < body.v_template[at, 1].mean()] = 0.0
        left = np.linalg.norm(moved - wanted) / np.linalg.norm(wanted)
        assert left < most, (name, left)
        np.testing.assert_allclose(posed(rig, name), rest, atol=1e-6)


def test_adding_again_adds_nothing_and_another_mesh_is_refused(face: bpy.types.Object, body: BodyFile) -> None:
    assert add_face_shapes(face, body) == 0
    other = bpy.data.objects.new("Other", bpy.data.meshes.new("Other"))
    other.data.from_pydata([(0, 0, 0), (1, 0, 0)], [], [])
    other.shape_key_add(name="Basis")
    with pytest.raises(BodyInvalid):
        add_face_shapes(other, body)


def test_a_mannequin_has_no_expression_and_a_person_has_it_again(
    face: bpy.types.Object, rig: Rig, body: BodyFile
) -> None:
    add_face_bones(rig.armature, face, body)
    jaw = rig.armature.pose.bones["jaw"]
    jaw.constraints.remove(jaw.constraints[0])  # as in older files
    assert add_face_bones(rig.armature, face, body) == 0 and len(jaw.constraints) == 1
    show_look(face, MANNEQUIN)
    blank = evaluated(face)
    np.testing.assert_allclose(posed(rig, "jaw", (19.0, 0.0, 0.0)), blank, atol=1e-6)
    face.data.shape_keys.key_blocks["jawOpen"].value = 1.0
    np.testing.assert_allclose(evaluated(face), blank, atol=1e-6)
    show_look(face, PERSON_LOOK)
    wide = evaluated(face)
    assert np.linalg.norm(wide - posed(rig, "jaw"), axis=1).max() > 0.02
    assert np.linalg.norm(evaluated(face) - blank, axis=1).max() > 0.02


def test_a_body_with_fingers_has_a_face_and_a_foreign_one_has_none(scene: bpy.types.Scene, files: object) -> None:
    hands = read_body(default_body_path(), SMPL_HANDS)
    mesh = create_rig("Hands", hands, np.zeros(10), scene.collection).mesh
    assert add_face_shapes(mesh, hands) == 52
    assert not files.body.face_shapes  # type: ignore[attr-defined]


def evaluated(mesh: bpy.types.Object) -> np.ndarray:
    """Return the (V, 3) evaluated vertices."""
    bpy.context.view_layer.update()
    found = mesh.evaluated_get(bpy.context.evaluated_depsgraph_get())
    return np.array([vertex.co for vertex in found.data.vertices])


def test_a_bone_of_the_user_keeps_its_name(rig: Rig, body: BodyFile) -> None:
    bpy.context.view_layer.objects.active = rig.armature
    bpy.ops.object.mode_set(mode="EDIT")
    rig.armature.data.edit_bones.new("jaw").tail = (0.0, 0.0, 0.1)
    bpy.ops.object.mode_set(mode="OBJECT")
    assert add_face_bones(rig.armature, rig.mesh, body) == 4
    assert len(face_bones(rig.armature)) == 4 and add_face_bones(rig.armature, rig.mesh, body) == 0
