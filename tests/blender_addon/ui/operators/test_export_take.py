"""The export operator does what the function does, and says what is wrong in a sentence."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import bpy
import pytest

import blender_addon
from blender_addon._exchange.diagnostics import Severity, diagnostic
from blender_addon.animation.takes import DIAGNOSTICS
from blender_addon.export.formats import FORMATS
from blender_addon.scene.bake import BakedTake
from blender_addon.scene.session import needs_this_file
from blender_addon.ui.operators import export


@pytest.fixture
def registered(scene: bpy.types.Scene) -> Iterator[None]:
    blender_addon.register()
    yield
    blender_addon.unregister()


@pytest.fixture
def selected(registered: None, take: BakedTake) -> BakedTake:
    bpy.context.view_layer.objects.active = take.mesh
    return take


def glb_json(path: Path) -> dict[str, Any]:
    data = path.read_bytes()
    return json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])


def test_it_writes_the_format_that_was_chosen(selected: BakedTake, tmp_path: Path) -> None:
    path = tmp_path / "ein Gang ü.trc"
    assert bpy.ops.mocap.export_take(filepath=str(path), format="trc") == {"FINISHED"}
    assert path.read_text(encoding="utf-8").startswith("PathFileType")
    items = bpy.ops.mocap.export_take.get_rna_type().properties["format"].enum_items
    assert [item.identifier for item in items] == list(FORMATS)


def test_what_one_camera_left_open_is_a_warning_of_every_export(
    selected: BakedTake, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    found = diagnostic("one_camera", size=21.0, share=4.0, source="the specified height")
    noted = diagnostic("scene_message", severity=Severity.NOTE, text="Read as metres.")
    selected.action[DIAGNOSTICS] = json.dumps([found.as_dict(), noted.as_dict()])
    assert bpy.ops.mocap.export_take(filepath=str(tmp_path / "walk.csv"), format="csv") == {"FINISHED"}
    out = capfd.readouterr().out
    assert (
        "Info: Wrote 60 frames" in out
        and "Warning: With one camera, depth is estimated" in out
        and "Read as metres" not in out
    )


def test_errors_are_sentences_and_nothing_is_overwritten(selected: BakedTake, tmp_path: Path) -> None:
    path = tmp_path / "walk.csv"
    path.write_text("mine")
    with pytest.raises(RuntimeError, match=r"walk\.csv already exists. Nothing was overwritten"):
        bpy.ops.mocap.export_take(filepath=str(path), format="csv")
    assert path.read_text() == "mine"
    with pytest.raises(RuntimeError, match="needs a saved file"):
        bpy.ops.mocap.export_take(filepath="//walk.csv", format="csv")


def test_the_file_browser_shows_the_rate_of_the_solve_unless_one_is_set(selected: BakedTake) -> None:
    bpy.context.scene.render.fps = 24
    chosen = SimpleNamespace(fps=0.0, browse=lambda *of: {"RUNNING_MODAL"})
    export.MOCAP_OT_export_take.invoke(chosen, bpy.context, None)
    assert chosen.fps == pytest.approx(selected.action["fps"]) != 24.0
    chosen.fps = 12.0
    export.MOCAP_OT_export_take.invoke(chosen, bpy.context, None)
    assert chosen.fps == 12.0
    selected.armature.animation_data.action = None
    chosen.fps = 0.0
    export.MOCAP_OT_export_take.invoke(chosen, bpy.context, None)
    assert chosen.fps == 24.0


def scripted(value: bpy.types.Driver) -> None:
    value.type, value.expression = "SCRIPTED", "[frame][0]"


@pytest.mark.parametrize("owner", ["shape key", "target"])
def test_a_second_blender_is_spared_where_drivers_of_what_it_depends_on_need_python(
    selected: BakedTake, owner: str
) -> None:
    objects = (selected.armature, selected.mesh)
    assert not needs_this_file(objects)
    if owner == "shape key":
        key = selected.mesh.shape_key_add(name="Driven")
        scripted(key.driver_add("value").driver)
        assert needs_this_file([selected.armature]), "keys of this mesh drive bones"
    else:
        target, parent = (bpy.data.objects.new(name, None) for name in ("Target", "Parent"))
        target.parent = parent
        scripted(parent.driver_add("location", 0).driver)
        selected.armature.pose.bones["head"].constraints.new("COPY_ROTATION").target = target
    assert needs_this_file(objects)


def test_it_waits_for_a_take(registered: None, scene: bpy.types.Scene, take: BakedTake) -> None:
    bpy.context.view_layer.objects.active = take.cameras[0]
    assert not bpy.ops.mocap.export_take.poll()
    bpy.context.view_layer.objects.active = take.armature
    assert bpy.ops.mocap.export_take.poll()


@pytest.mark.parametrize("mode", ["POSE", "EDIT"])
def test_it_writes_from_any_mode_and_leaves_it_as_it_was(selected: BakedTake, tmp_path: Path, mode: str) -> None:
    bpy.context.view_layer.objects.active = selected.armature
    bpy.ops.object.mode_set(mode=mode)
    path = tmp_path / "walk.fbx"
    assert bpy.ops.mocap.export_take(filepath=str(path), format="fbx") == {"FINISHED"} and path.is_file()
    assert bpy.context.mode == {"POSE": "POSE", "EDIT": "EDIT_ARMATURE"}[mode]
    assert bpy.context.object == selected.armature


def test_the_skeleton_alone_and_a_range_are_written(selected: BakedTake, tmp_path: Path) -> None:
    whole, bare = tmp_path / "whole.glb", tmp_path / "bare.glb"
    assert bpy.ops.mocap.export_take(filepath=str(whole), format="gltf") == {"FINISHED"}
    done = bpy.ops.mocap.export_take(
        filepath=str(bare), format="gltf", skeleton=True, use_range=True, first=5, last=14, fps=selected.action["fps"]
    )
    assert done == {"FINISHED"}
    with_skin, without = map(glb_json, (whole, bare))
    assert with_skin["meshes"] and not without.get("meshes")
    assert [clip["name"] for clip in without["animations"]] == [selected.action.name]
    assert bpy.context.scene.name == "Scene"


def test_registering_leaves_no_menu_entry_behind(scene: bpy.types.Scene) -> None:
    menu: Any = bpy.types.TOPBAR_MT_file_export
    before = len(menu._dyn_ui_initialize())
    blender_addon.register()
    assert len(menu._dyn_ui_initialize()) == before + 1, "take and markers"
    blender_addon.unregister()
    assert len(menu._dyn_ui_initialize()) == before
