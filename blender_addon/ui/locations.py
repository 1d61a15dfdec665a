"""Paths of a scene: those that begin with ``//``, and where captures and takes are written."""

from __future__ import annotations

from pathlib import Path

import bpy

from .._exchange.errors import OutputNotWritable
from .._exchange.unfinished import probe
from . import ADDON

_BESIDE = "mocap"
RELATIVE = (
    {"PATH_SUPPORTS_BLEND_RELATIVE"}
    if "is_path_supports_blend_relative" in bpy.types.Property.bl_rna.properties
    else set()
)
"""Option of a path property that may begin with ``//``; before Blender 4.5 every one may."""


def absolute(text: str) -> Path:
    """Return the path that a property means."""
    return Path(bpy.path.abspath(text))


def files_folder(scene: bpy.types.Scene) -> Path:
    """Return the folder of captures and takes, made if need be.

    That is what the scene says; else ``mocap`` beside the .blend file; else, in a file that was never saved, a folder
    of the user's that outlives the session.

    Raises:
        OutputNotWritable: the folder cannot be made or written to.
    """
    return usable(_wanted(scene))


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


def is_beside_file(scene: bpy.types.Scene) -> bool:
    """Return whether takes land where the user expects them: in a chosen folder or beside the saved file."""
    return bool(scene.mocap.folder or bpy.data.filepath)


def _wanted(scene: bpy.types.Scene) -> Path:
    if scene.mocap.folder:
        return absolute(scene.mocap.folder)
    if bpy.data.filepath:
        return Path(bpy.data.filepath).parent / _BESIDE
    try:
        return Path(bpy.utils.extension_path_user(ADDON, path=_BESIDE))
    except ValueError:  # run from the source tree: not an installed extension
        return Path(bpy.utils.user_resource("DATAFILES", path=_BESIDE))
