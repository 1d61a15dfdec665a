"""Duplicated, appended and overridden bodies keep their own pose correctives."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
import pytest

from blender_addon.body.body_file import BodyFile
from blender_addon.body.rig import Rig, create_rig
from tests.support.posed_rig import evaluated, pose

_TURNS = 0.6 * np.random.default_rng(1).normal(size=(2, 24, 3))


def _rig_of(objects: list[bpy.types.Object]) -> Rig:
    armature = next(obj for obj in objects if obj.type == "ARMATURE")
    return Rig(armature, next(obj for obj in objects if obj.parent == armature))


def test_a_duplicate_follows_its_own_bones(rig: Rig) -> None:
    expected = []
    for turns in _TURNS:
        pose(rig, turns)
        expected.append(evaluated(rig)[1])
    for obj in (rig.armature, rig.mesh):
        obj.select_set(True)
    bpy.ops.object.duplicate()
    duplicate = _rig_of(list(bpy.context.selected_objects))
    pose(duplicate, _TURNS[0])
    for body, skin in zip((duplicate, rig), expected, strict=True):
        np.testing.assert_allclose(evaluated(body)[1], skin, atol=1e-6)


@pytest.mark.parametrize("link", [False, True])
def test_another_file_brings_the_correctives_and_shows_nothing_else(
    scene: bpy.types.Scene, body: BodyFile, tmp_path: Path, link: bool
) -> None:
    collection = bpy.data.collections.new("Body")
    scene.collection.children.link(collection)
    rig = create_rig("Body", body, np.zeros(10), collection)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "body.blend"), copy=True)
    pose(rig, _TURNS[0])
    expected = evaluated(rig)[1]
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    with bpy.data.libraries.load(str(tmp_path / "body.blend"), link=link) as (_, wanted):
        wanted.collections = ["Body"]
    scene, brought = bpy.context.scene, bpy.data.collections["Body"]
    scene.collection.children.link(brought)
    if link:
        brought = brought.override_hierarchy_create(scene, bpy.context.view_layer)
    other = _rig_of(list(brought.all_objects))
    pose(other, _TURNS[0])
    np.testing.assert_allclose(evaluated(other)[1], expected, atol=1e-6)
    assert not scene.collection.objects
