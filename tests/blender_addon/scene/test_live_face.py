"""A face moves the shape keys that have its channels' names, or those that a table names, and no others."""

from __future__ import annotations

import json

import bpy
import pytest

from blender_addon._exchange.errors import FileDamaged, FileMissing
from blender_addon.scene.live_figure import LiveFace, read_face_table


@pytest.fixture
def head(scene: bpy.types.Scene) -> bpy.types.Object:
    mesh = bpy.data.meshes.new("head")
    mesh.from_pydata([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [], [(0, 1, 2)])
    found = bpy.data.objects.new("Kopf", mesh)
    scene.collection.objects.link(found)
    for name in ("Basis", "jawOpen", "Blink L", "smile"):
        found.shape_key_add(name=name)
    return found


def values(head: bpy.types.Object) -> dict[str, float]:
    return {key.name: round(key.value, 3) for key in head.data.shape_keys.key_blocks}


def test_names_and_the_table_choose_the_keys_and_sliders_limit_them(head, tmp_path):
    (tmp_path / "face.json").write_text(json.dumps({"eyeBlinkLeft": "Blink L"}), encoding="utf-8")
    face, basis = LiveFace("Kopf", read_face_table(tmp_path / "face.json")), values(head)["Basis"]
    assert face.show({"JawOpen": 0.4, "EyeBlinkLeft": 0.9, "tongueOut": 1.0, "smile": 7.0, "basis": 0.5}) == 3
    assert values(head) == {"Basis": basis, "jawOpen": 0.4, "Blink L": 0.9, "smile": 1.0}
    assert face.show({"JawOpen": 0.0}) == 1 and values(head)["Blink L"] == 0.9


def test_a_mesh_that_is_gone_or_has_no_keys_changes_nothing(head, scene):
    scene.collection.objects.link(bpy.data.objects.new("Leer", None))
    assert LiveFace("Leer").show({"smile": 1.0}) == 0
    bpy.data.objects.remove(head)
    assert LiveFace("Kopf").show({"smile": 1.0}) == 0


@pytest.mark.parametrize("text", ["[]", '{"a": 1}', "nonsense", '"smile"'])
def test_what_is_no_table_is_refused(tmp_path, text):
    (tmp_path / "face.json").write_text(text, encoding="utf-8")
    with pytest.raises(FileDamaged):
        read_face_table(tmp_path / "face.json")
    with pytest.raises(FileMissing):
        read_face_table(tmp_path / "nowhere.json")
