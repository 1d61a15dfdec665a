"""Where a user's own presets lie: beside Blender's other presets, so that they outlive the extension."""

from __future__ import annotations

from pathlib import Path

import bpy

_FOLDER = "presets/manifold_mocap_rigs"


def user_presets_folder(*, make: bool = False) -> Path | None:
    """Return the folder of the user's presets, None where Blender has no folder for a user's files."""
    folder = bpy.utils.user_resource("SCRIPTS", path=_FOLDER, create=make)
    return Path(folder) if folder else None
