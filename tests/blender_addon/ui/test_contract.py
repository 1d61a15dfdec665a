"""What every operator, panel and property of the add-on keeps to."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import bpy
import pytest

import blender_addon
from blender_addon.ui import properties, registration

ADDON = Path(blender_addon.__file__).parent
EXCHANGE = ADDON.parent / "solver_backend" / "exchange"


def classes_of(base: type) -> list[type]:
    """Return the add-on's own classes below one of Blender's."""
    found = [cls for cls in base.__subclasses__() if cls.__module__.startswith("blender_addon")]
    mixed = [cls for cls in found if cls.__name__.startswith(("MOCAP_", "VIEW3D_"))]
    assert mixed
    return mixed


@pytest.fixture
def registered(scene: bpy.types.Scene) -> Iterator[None]:
    registration.register()
    yield
    registration.unregister()


def test_operators_are_named_after_their_class_and_say_what_they_do(registered):
    for cls in classes_of(bpy.types.Operator):
        assert cls.bl_idname == f"mocap.{cls.__name__.removeprefix('MOCAP_OT_')}"
        assert cls.bl_label and len(cls.bl_description) > len(cls.bl_label) and not cls.bl_description.endswith(".")
        assert hasattr(bpy.types, cls.__name__), f"{cls.__name__} is not in the table"


def test_operators_that_change_the_scene_can_be_undone(registered):
    keeps = {
        "MOCAP_OT_cancel",
        "MOCAP_OT_dismiss",
        "MOCAP_OT_set_up_detector",
        "MOCAP_OT_test_detector",
        "MOCAP_OT_test_python",
        "MOCAP_OT_show_log",
        "MOCAP_OT_open_report",
        "MOCAP_OT_open_video_picture",
        "MOCAP_OT_ghost_take",
        "MOCAP_OT_export_take",
        "MOCAP_OT_export_markers",
        "MOCAP_OT_live_stop",
        "MOCAP_OT_send_take",
        "MOCAP_OT_open_benchmark",
    }
    for cls in classes_of(bpy.types.Operator):
        undo = "UNDO" in getattr(cls, "bl_options", set())
        assert undo == (cls.__name__ not in keeps), cls.__name__


def test_panels_stand_in_the_order_of_the_work_and_acquisition_in_a_tab_of_its_own(registered):
    panels = classes_of(bpy.types.Panel)
    acquisition = {"Run", "Live", "Sensor Array", "Studio", "Benchmark", "Data Set"}
    assert {panel.bl_label for panel in panels if panel.bl_category == "Acquire"} == acquisition
    assert {panel.bl_category for panel in panels} == {"MoCap", "Acquire"}
    stages = {panel.stage for panel in panels if panel.bl_category == "MoCap" and hasattr(panel, "stage")}
    assert stages == {name for name, *_ in properties.STAGES}
    top = sorted((panel for panel in panels if not hasattr(panel, "bl_parent_id")), key=lambda panel: panel.bl_order)
    assert [panel.bl_label for panel in top] == [
        "Stages",
        "Run",
        "Capture",
        "Cameras",
        "Solve",
        "Result",
        "Review",
        "Export",
        "Retarget",
        "Live",
        "Sensor Array",
        "Studio",
    ]
    parents = {panel.bl_idname for panel in top}
    assert all(panel.bl_parent_id in parents for panel in panels if panel not in top)
    assert all(hasattr(bpy.types, panel.__name__) for panel in panels)


def test_settings_hang_on_one_pointer_and_are_described(registered):
    assert isinstance(bpy.context.scene.mocap, properties.MocapSettings)
    shown = (properties.MocapReading, properties.MocapSolve, properties.MocapLive)
    for cls in shown:
        for name, prop in cls.bl_rna.properties.items():
            assert name in ("rna_type", "name") or prop.description, f"{cls.__name__}.{name}"


def test_no_keys_are_taken(registered):
    assert bpy.context.window_manager.keyconfigs.addon is None or not any(
        item.idname.startswith("mocap.")
        for keymap in bpy.context.window_manager.keyconfigs.addon.keymaps
        for item in keymap.keymap_items
    )


@cache
def nodes(folder: Path) -> list[tuple[str, ast.AST]]:
    """Return all parts of a folder's modules, each with the path of its file."""
    files = sorted(folder.rglob("*.py"))
    return [
        (path.relative_to(ADDON.parent).as_posix(), node)
        for path in files
        for node in ast.walk(ast.parse(path.read_text("utf-8")))
    ]


def test_nothing_is_looked_up_by_an_english_name() -> None:
    """``bpy.data.objects["Cube"]`` finds nothing in a German Blender."""
    named = [(name, node) for name, node in nodes(ADDON) if isinstance(node, ast.Subscript)]
    texts = [
        (n, node) for n, node in named if isinstance(node.slice, ast.Constant) and isinstance(node.slice.value, str)
    ]
    assert len(texts) > 100
    assert not [(name, ast.unparse(node)) for name, node in texts if ast.unparse(node.value).startswith("bpy.data.")]


def test_nothing_but_the_sender_of_poses_reaches_for_the_network() -> None:
    names = {"urllib", "http", "socket", "requests", "ftplib", "ssl", "asyncio"}
    imported = set[tuple[str, str]]()
    for file, node in (*nodes(ADDON), *nodes(EXCHANGE)):
        if isinstance(node, ast.Import):
            imported |= {(file, alias.name.split(".")[0]) for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module != "urllib.parse":  # texts alone
            imported.add((file, (node.module or "").split(".")[0]))
    # The manifest's permission, with its reason.
    assert {(file, name) for file, name in imported if name in names} == {
        ("solver_backend/exchange/vmc/sender.py", "socket")
    }
