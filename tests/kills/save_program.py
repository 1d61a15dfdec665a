"""Puts a solved take of another folder into a new scene and saves it: what is referenced is copied beside it."""

from __future__ import annotations

from pathlib import Path

import bpy

import blender_addon
from blender_addon.animation.takes import SolveFiles
from blender_addon.ui.operators.import_results import take_motion


def main() -> None:
    """Save ``project/scene.blend`` with the take of ``elsewhere``."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    blender_addon.register()
    files = (Path("elsewhere", name).resolve() for name in ("take.npz", "capture.npz", "take.html", "job.json"))
    take_motion(bpy.context, SolveFiles(*files))
    bpy.ops.wm.save_as_mainfile(filepath=str(Path("project", "scene.blend").resolve()))
    blender_addon.unregister()


if __name__ == "__main__":
    main()
