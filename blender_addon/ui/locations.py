"""Where a scene's captures and takes are written."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

import bpy

from .._exchange.errors import OutputNotWritable
from .._exchange.unfinished import probe
from ..conventions.file_paths import BESIDE, absolute, sessions_folder

RELATIVE = (
    {"PATH_SUPPORTS_BLEND_RELATIVE"}
    if "is_path_supports_blend_relative" in bpy.types.Property.bl_rna.properties
    else set()
)
"""Option of a path property that may begin with ``//``; before Blender 4.5 every one may."""


def files_folder(scene: bpy.types.Scene) -> Path:
    """Return the folder of captures and takes, made if need be.

    That is the scene's own setting; else ``mocap`` beside the .blend file; else, in a file that was never saved, a
    session folder of the user's, from where saving moves them beside the file.

    Raises:
        OutputNotWritable: the folder cannot be made or written to.
    """
    settings = scene.mocap
    if settings.folder and (bpy.data.filepath or not settings.folder.startswith("//")):
        return usable(absolute(settings.folder))
    if bpy.data.filepath:
        return usable(Path(bpy.data.filepath).parent / BESIDE)
    if not settings.session:
        settings.session = str(_new_session())
    return usable(Path(settings.session))


def usable(folder: Path) -> Path:
    """Return a folder of captures or takes, made if need be.

    Raises:
        OutputNotWritable: it cannot be made or written to, or the disk is full.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe(folder)
    except OSError as error:
        raise OutputNotWritable(
            f"The folder for takes cannot be written to: {error.strerror or error}.",
            where=str(folder),
            hint="Free some space there, or choose another folder under Advanced in the Solve panel.",
        ) from error
    return folder


def waits_for_saving(scene: bpy.types.Scene) -> str:
    """Return the session folder in which an unsaved scene's takes wait, "" if they lie where they belong."""
    settings = scene.mocap
    if bpy.data.filepath or (settings.folder and not settings.folder.startswith("//")):
        return ""
    return settings.session or str(sessions_folder())


def _new_session() -> Path:
    """Return a folder named after the time of day that nobody has used."""
    name = f"unsaved {datetime.now():%Y-%m-%d %H.%M.%S}"
    names = (name if n == 1 else f"{name} ({n})" for n in range(1, 1000))
    return next(path for path in map(sessions_folder().__truediv__, names) if not path.exists())
