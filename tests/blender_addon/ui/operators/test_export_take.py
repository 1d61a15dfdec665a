"""The export operator does what the function does, and says what is wrong in a sentence."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import bpy
import pytest

import blender_addon
from blender_addon.export.formats import FORMATS
from blender_addon.scene.bake import BakedTake


@pytest.fixture
def registered(scene: bpy.types.Scene) -> Iterator[None]:
    blender_addon.register()
    yield
    blender_addon.unregister()


@pytest.fixture
def selected(registered: None, take: BakedTake) -> BakedTake:
    bpy.context.view_layer.objects.active = take.mesh
    return take


def test_it_writes_the_format_that_was_chosen(selected: BakedTake, tmp_path: Path) -> None:
    path = tmp_path / "ein Gang ü.trc"
    assert bpy.ops.mocap.export_take(filepath=str(path), format="trc") == {"FINISHED"}
    assert path.read_text(encoding="utf-8").startswith("PathFileType")
    items = bpy.ops.mocap.export_take.get_rna_type().properties["format"].enum_items
    assert [item.identifier for item in items] == list(FORMATS)


def test_errors_are_sentences_and_nothing_is_overwritten(selected: BakedTake, tmp_path: Path) -> None:
    path = tmp_path / "walk.csv"
    path.write_text("mine")
    with pytest.raises(RuntimeError, match=r"walk\.csv is already there and not overwritten"):
        bpy.ops.mocap.export_take(filepath=str(path), format="csv")
    assert path.read_text() == "mine"
    with pytest.raises(RuntimeError, match="needs a saved file"):
        bpy.ops.mocap.export_take(filepath="//walk.csv", format="csv")


def test_it_waits_for_a_take(registered: None, scene: bpy.types.Scene, take: BakedTake) -> None:
    bpy.context.view_layer.objects.active = take.cameras[0]
    assert not bpy.ops.mocap.export_take.poll()
    bpy.context.view_layer.objects.active = take.armature
    assert bpy.ops.mocap.export_take.poll()
    bpy.ops.object.mode_set(mode="POSE")
    assert not bpy.ops.mocap.export_take.poll()


def test_registering_leaves_no_menu_entry_behind(scene: bpy.types.Scene) -> None:
    menu: Any = bpy.types.TOPBAR_MT_file_export
    before = len(menu._dyn_ui_initialize())
    blender_addon.register()
    assert len(menu._dyn_ui_initialize()) == before + 2, "take and markers"
    blender_addon.unregister()
    assert len(menu._dyn_ui_initialize()) == before
