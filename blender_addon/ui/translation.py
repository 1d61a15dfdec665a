"""Translate the add-on's labels into German, in a separate translation context.

Messages and tooltips are not translated.
"""

from __future__ import annotations

from pathlib import Path

import bpy

CONTEXT = "Manifold MoCap"  # Translation context of all the add-on's texts.
_GERMAN = Path(__file__).with_name("german.txt")
"""One label per line: English = German. The file is not JSON, because reading JSON would load another module."""
_LANGUAGES = ("de_DE", "de")  # Blender's locale names for German. They differ between releases.


def german() -> dict[str, str]:
    """Return a dict from each English label to its German translation."""
    lines = _GERMAN.read_text(encoding="utf-8").splitlines()
    return {english: label for english, _, label in (line.partition(" = ") for line in lines)}


def add_translations() -> None:
    """Register the German labels."""
    labels = {(CONTEXT, english): label for english, label in german().items()}
    bpy.app.translations.register(CONTEXT, dict.fromkeys(_LANGUAGES, labels))


def remove_translations() -> None:
    """Unregister the German labels."""
    bpy.app.translations.unregister(CONTEXT)
