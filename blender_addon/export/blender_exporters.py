"""Calling Blender's own exporters, whose settings differ between versions."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy

from ..errors import ExporterMissing, ExportFailed


def run_exporter(
    operator: Any, path: Path, settings: dict[str, Any], newer_settings: dict[str, Any] | None = None
) -> None:
    """Call an exporter.

    Args:
        operator: such as ``bpy.ops.export_scene.fbx``.
        path: file to write.
        settings: known to every version we support.
        newer_settings: left out where this Blender does not know them.

    Raises:
        ExporterMissing: this Blender has no such exporter.
        ExportFailed: it refused, or wrote nothing.
    """
    try:
        known = {prop.identifier for prop in operator.get_rna_type().properties}
    except KeyError as error:
        raise ExporterMissing(
            f"This Blender cannot write {path.suffix[1:].upper()}.",
            where=f"Blender {bpy.app.version_string}",
            hint="Enable the format's add-on in the preferences, or use a Blender that was built with it.",
        ) from error
    fitting = {name: value for name, value in (newer_settings or {}).items() if name in known}
    try:
        done = operator(filepath=str(path), check_existing=False, **settings, **fitting)
    except RuntimeError as error:
        raise ExportFailed(f"Blender's exporter failed: {str(error).strip()}", where=path.name) from error
    if done != {"FINISHED"} or not path.is_file():
        raise ExportFailed(
            "Blender's exporter wrote nothing.", where=path.name, hint="Its messages are in the console."
        )
