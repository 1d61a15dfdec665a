"""A saved choice stays the same when another one is removed before it, and a removed one opens as the default."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np

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


def test_buttons_hold_the_numbers_of_choices_exactly(mocap) -> None:
    """Blender's buttons keep the number of a choice in single precision."""
    owners = [cls for base in (bpy.types.PropertyGroup, bpy.types.Operator) for cls in base.__subclasses__()]
    ours = [cls for cls in owners if cls.__module__.startswith("blender_addon") and hasattr(cls, "bl_rna")]
    found = [(cls, p) for cls in ours for p in cls.bl_rna.properties if p.type == "ENUM" and not p.is_enum_flag]
    assert any(p.identifier == "stage" for _, p in found)
    for cls, prop in found:
        numbers = [item.value for item in prop.enum_items]
        assert len(set(numbers)) == len(numbers), (cls, prop.identifier)
        assert all(int(np.float32(number)) == number for number in numbers), (cls, prop.identifier)
