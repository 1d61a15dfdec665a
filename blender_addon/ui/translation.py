"""Translate labels to German in our own translation context.

Sentences and tooltips are English.
"""

from __future__ import annotations

from pathlib import Path

import bpy

CONTEXT = "Manifold MoCap"  # Context of all our texts.
_GERMAN = Path(__file__).with_name("german.txt")
"""One label per line: English = German. JSON is not used, because reading it would load another module."""
_LANGUAGES = ("de_DE", "de")  # Blender's locale names for German. They differ between releases.


def german() -> dict[str, str]:
    """Return the German translation of each English label."""
    lines = _GERMAN.read_text(encoding="utf-8").splitlines()
    return {english: label for english, _, label in (line.partition(" = ") for line in lines)}


def add_translations() -> None:
    """Register the translations of labels."""
    labels = {(CONTEXT, english): label for english, label in german().items()}
    bpy.app.translations.register(CONTEXT, dict.fromkeys(_LANGUAGES, labels))


def remove_translations() -> None:
    """Unregister the translations of labels."""
    bpy.app.translations.unregister(CONTEXT)
