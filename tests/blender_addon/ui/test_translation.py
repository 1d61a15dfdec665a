"""German labels: every label of the panels has one, and Blender gets them in our context."""

from __future__ import annotations

import re
from types import SimpleNamespace

import bpy

from blender_addon.ui import translation
from blender_addon.ui.translation import CONTEXT, german
from tests.support.narrow_layout import draw_panel
from tests.support.shown_panels import panels_of_all_stages

SAME = re.compile(
    r"[A-Z0-9 +\-Γ]+|[a-z_]+|Spine\d|Active Object .*|Findings|Doubted"
    r"|MediaPipe|NumPy|PyTorch|Pose2Sim|Cycles|Alembic|Godot|Maya|Unity|Unreal|Blend"
)
"""Abbreviations and names, and the names of properties that no panel shows."""


def labels() -> set[str]:
    """Return the labels of our panels, operators, properties and items."""
    found: set[str] = set()
    for base in (bpy.types.Operator, bpy.types.Panel, bpy.types.PropertyGroup, bpy.types.AddonPreferences):
        for cls in base.__subclasses__():
            if not cls.__module__.startswith("blender_addon") or not cls.is_registered:
                continue
            found.add(getattr(cls, "bl_label", ""))
            rna = getattr(bpy.types, cls.__name__, cls).bl_rna
            for prop in (p for p in rna.properties if p.translation_context == CONTEXT):
                found.add(prop.name)
                found.update(item.name for item in prop.enum_items) if prop.type == "ENUM" else None
    return {label for label in found if label and not SAME.fullmatch(label)}


def test_every_label_has_a_german_one(mocap) -> None:
    assert len(labels()) > 250
    assert sorted(labels() - german().keys()) == [], "blender_addon/ui/german.txt lacks a line"


def test_what_panels_draw_has_a_german_one(mocap, solved_take) -> None:
    drawn = {text for panel in panels_of_all_stages() for text in draw_panel(panel, 283).drawn}
    words = {text for text in drawn if re.fullmatch(r"[A-Z][\w ']*…?", text) and len(text.split()) <= 3}
    assert len(words) > 60 and "Previous" in words
    unknown = words - german().keys() - {"Take 01"}
    assert sorted(text for text in unknown if not SAME.fullmatch(text)) == [], (
        "blender_addon/ui/german.txt lacks a line"
    )


def test_the_labels_are_registered_in_our_context_and_taken_back(monkeypatch) -> None:
    kept: dict[str, dict[str, dict[tuple[str, str], str]]] = {}
    stand_in = SimpleNamespace(register=kept.__setitem__, unregister=kept.pop)
    monkeypatch.setattr(translation, "bpy", SimpleNamespace(app=SimpleNamespace(translations=stand_in)))
    translation.add_translations()
    [table] = kept.values()
    assert table["de_DE"][CONTEXT, "Solve"] == "Lösen" and len(table["de_DE"]) == len(german())
    translation.remove_translations()
    assert not kept
