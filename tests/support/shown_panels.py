"""Which of the add-on's panels are to be seen."""

from __future__ import annotations

import bpy

from blender_addon.ui.properties import STAGES


def shown_panels() -> list[type]:
    """Return our panels that are to be seen now."""
    ours = [cls for cls in bpy.types.Panel.__subclasses__() if cls.__module__.startswith("blender_addon")]
    return [cls for cls in ours if not hasattr(cls, "poll") or cls.poll(bpy.context)]


def panels_of_all_stages() -> list[type]:
    """Return our panels that are to be seen in one stage or another; the stage that was open stays so."""
    settings = bpy.context.scene.mocap
    opened, found = settings.stage, dict.fromkeys(shown_panels())
    for name, *_ in STAGES:
        settings.stage = name
        found |= dict.fromkeys(shown_panels())
    settings.stage = opened
    return list(found)
