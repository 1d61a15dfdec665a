"""Blender's engines by the studio's names, and what each is set to."""

from __future__ import annotations

import bpy

from ..errors import RenderFailed
from .paint import COLOURS

_IDS = {
    "workbench": ("BLENDER_WORKBENCH",), "cycles": ("CYCLES",), "eevee": ("BLENDER_EEVEE_NEXT", "BLENDER_EEVEE"),
}  # fmt: skip
_BRIGHT = "paint.sl"
"""The brightest of the lights that come with Blender."""


def engine_id(name: str) -> str:
    """Return Blender's id of an engine.

    Raises:
        RenderFailed: this Blender was built without it.
    """
    scene = bpy.data.scenes.new("engines")
    try:
        found = next((candidate for candidate in _IDS[name] if _takes(scene, candidate)), None)
        usable = [other for other, ids in _IDS.items() if any(_takes(scene, candidate) for candidate in ids)]
    finally:
        bpy.data.scenes.remove(scene)
    if found is None:
        raise RenderFailed(
            f"This Blender has no engine '{name}'.", where=bpy.app.version_string, hint=f"It has {', '.join(usable)}."
        )
    return found


def set_engine(scene: bpy.types.Scene, name: str, samples: int) -> None:
    """Set a scene to an engine.

    Raises:
        RenderFailed: this Blender was built without it.
    """
    scene.render.engine = engine_id(name)
    if name == "workbench":
        display = scene.display
        # Workbench's own smoothing moves edges by a fifth of a pixel; pictures rendered larger do not.
        display.render_aa = "OFF"
        shading = display.shading
        shading.light, shading.color_type = "STUDIO", "VERTEX"
        if _BRIGHT in bpy.context.preferences.studio_lights:
            shading.studio_light = _BRIGHT
        shading.show_shadows = True
        shading.show_specular_highlight = False
    elif name == "cycles":
        cycles = scene.cycles
        cycles.samples, cycles.use_adaptive_sampling = samples, False
        cycles.max_bounces, cycles.diffuse_bounces, cycles.glossy_bounces = 3, 2, 1
        cycles.transmission_bounces = cycles.volume_bounces = cycles.transparent_max_bounces = 0
        cycles.use_denoising = True
        cycles.seed = 0
        scene.render.use_persistent_data = True
    else:
        scene.eevee.taa_render_samples = samples


def enlargement(name: str) -> int:
    """Return how many times larger an engine's pictures are rendered, to be averaged afterwards."""
    return 2 if name == "workbench" else 1


def show_paint(mesh: bpy.types.Mesh) -> None:
    """Make the corner colours those that Workbench shows."""
    mesh.color_attributes.active_color = mesh.color_attributes[COLOURS]
    mesh.color_attributes.render_color_index = mesh.color_attributes.find(COLOURS)


def _takes(scene: bpy.types.Scene, engine: str) -> bool:
    """Return whether a scene can be set to an engine; Blender lists them nowhere."""
    try:
        scene.render.engine = engine
    except TypeError:
        return False
    return True
