"""A saved choice stays the same when another one is removed before it, and a removed one opens as the default."""

from __future__ import annotations

from pathlib import Path

import bpy

from blender_addon.ui.operators.base import after_load
from blender_addon.ui.setting_properties import choice, properties_of

OLDER = [(name, name, "") for name in ("auto", "keypoints", "clap", "sound", "flash", "none")]
NEWER = [row for row in OLDER if row[0] not in ("clap", "flash")]


def declare(items: list[tuple[str, str, str]]) -> None:
    made = properties_of({"sync": choice("Sync", "", items).setting}, {"sync": "auto"})
    bpy.types.Scene.saved_sync = made.__annotations__["sync"]


def test_saved_choices_outlive_the_removal_of_others(tmp_path: Path) -> None:
    file = str(tmp_path / "choices.blend")
    for saved in ("sound", "none"):
        declare(OLDER)
        bpy.context.scene.saved_sync = saved
        bpy.ops.wm.save_as_mainfile(filepath=file)
        declare(NEWER)
        bpy.ops.wm.open_mainfile(filepath=file)
        assert bpy.context.scene.saved_sync == saved
    del bpy.types.Scene.saved_sync


def test_a_choice_of_another_version_opens_as_the_default(mocap) -> None:
    mocap.videos.property_unset("cameras")
    mocap.videos["clocks"] = 4
    mocap.videos.people = 2
    assert mocap.videos.clocks == ""
    after_load()
    assert mocap.videos.clocks == "auto" and mocap.videos.people == 2
