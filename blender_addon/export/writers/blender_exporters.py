"""Calling Blender's own exporters, whose settings differ between versions."""

from __future__ import annotations

import errno
import os
from pathlib import Path
from typing import Any

import bpy

from ...errors import ExporterMissing, ExportFailed

_DISK = (errno.ENOSPC, errno.EFBIG, errno.EDQUOT, errno.EROFS, errno.EACCES)


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
        OSError: the disk is full or may not be written to.
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
        done = operator(filepath=os.path.abspath(path), check_existing=False, **settings, **fitting)
    except RuntimeError as error:
        _raise_if_disk(str(error), error)
        raise ExportFailed(f"Blender's exporter failed: {str(error).strip()}", where=path.name) from error
    if done != {"FINISHED"} or not path.is_file():
        raise ExportFailed(
            "Blender's exporter wrote nothing.", where=path.name, hint="Its messages are in the console."
        )


def _raise_if_disk(text: str, error: RuntimeError) -> None:
    """Raise what the system reported, where it stands in the traceback an exporter gives for an error."""
    for number in _DISK:
        if os.strerror(number) in text:
            raise OSError(number, os.strerror(number)) from error
