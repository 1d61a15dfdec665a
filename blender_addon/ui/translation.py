"""Our texts have a context of their own: Blender's translations of "Fast" or "Export" are of other things."""

from __future__ import annotations

import inspect
import typing
from typing import Any

import bpy

CONTEXT = "Manifold MoCap"
"""Context of all our texts; a translation of ours would be registered under it."""


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
