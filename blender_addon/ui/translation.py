"""Our texts have a context of their own: Blender's translations of "Fast" or "Export" are of other things.

Labels are translated to German; sentences and tooltips stay English.
"""

from __future__ import annotations

import inspect
import typing
from pathlib import Path
from typing import Any

import bpy

CONTEXT = "Manifold MoCap"
"""Context of all our texts, which their translations are registered under."""
_GERMAN = Path(__file__).with_name("german.txt")
"""A line a label: English = German. Reading JSON would load a module that a bare Blender has not."""
_LANGUAGES = ("de_DE", "de")
"""Blender's names of German, by its release."""


def german() -> dict[str, str]:
    """Return the German label of every English one."""
    lines = _GERMAN.read_text(encoding="utf-8").splitlines()
    return {english: label for english, _, label in (line.partition(" = ") for line in lines)}


def add_translations() -> None:
    """Register the labels in other languages."""
    labels = {(CONTEXT, english): label for english, label in german().items()}
    bpy.app.translations.register(CONTEXT, dict.fromkeys(_LANGUAGES, labels))


def remove_translations() -> None:
    """Take the labels back."""
    bpy.app.translations.unregister(CONTEXT)


def in_our_context(cls: Any) -> Any:
    """Return a class to be registered, whose own label and properties have our context."""
    if issubclass(cls, bpy.types.Operator | bpy.types.Panel | bpy.types.Menu):
        cls.bl_translation_context = CONTEXT
    own = inspect.get_annotations(cls)
    if any("bpy.props." in str(hint) for hint in own.values()):
        hints = typing.get_type_hints(cls)
        waiting = {name: hints[name] for name in own if hasattr(hints[name], "keywords")}
        for prop in waiting.values():
            prop.keywords.setdefault("translation_context", CONTEXT)
        cls.__annotations__ = {**own, **waiting}
    return cls
