"""Calling Blender's own exporters, whose settings differ between versions."""

from __future__ import annotations

import errno
import os
import shutil
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
        message = f"This Blender cannot write {path.suffix[1:].upper()}."
        hint = "Enable the format's add-on in the preferences, or use a Blender that was built with it."
        raise ExporterMissing(message, where=f"Blender {bpy.app.version_string}", hint=hint) from error
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


_RESERVE = 2**20
"""Bytes that stay free beside what is estimated; chosen by hand."""
_OGAWA, _FROZEN = b"Ogawa", 0xFF
_CRATE = b"PXR-USDC"


def require_space(path: Path, estimate: int) -> None:
    """Check that a file of about so many bytes, and a little more, fits on its disk.

    Raises:
        OSError: it does not.
    """
    free = shutil.disk_usage(path.parent).free
    if free < estimate + _RESERVE:
        mib = f"about {estimate / 2**20:.0f} MiB are needed, {free / 2**20:.0f} MiB are free"
        raise OSError(errno.ENOSPC, f"{os.strerror(errno.ENOSPC)}, {mib}")


def require_whole(path: Path) -> None:
    """Check that an Alembic (Ogawa) or USD (crate) file was written to its end.

    Ogawa's sixth byte is 255 once the archive is closed; a crate's header ends with the offset of a table of contents
    that is written last.

    Raises:
        OSError: it was not.
    """
    with path.open("rb") as stream:
        head = stream.read(24)
    is_whole = {
        _OGAWA: head[5:6] == bytes([_FROZEN]),
        _CRATE[:5]: head[:8] == _CRATE and 0 < int.from_bytes(head[16:24], "little") < path.stat().st_size,
    }
    if not is_whole.get(head[:5], False):
        raise OSError(errno.ENOSPC, "the exporter stopped in the middle of the file; the disk may be full")
