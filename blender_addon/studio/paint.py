"""Colours of a shot, drawn by its seed: skin, hair, cloth with patterns, walls and floor; corner colours of meshes.

A corner colour looks the same in every engine: Workbench shows it, Cycles and EEVEE read it as an attribute.
"""

from __future__ import annotations

import colorsys

import bpy
import numpy as np

from .scene_file import SceneFile

COLOURS = "paint"
"""Name of the colour attribute."""
_SKINS = ((0.60, 0.36, 0.25), (0.48, 0.27, 0.18), (0.33, 0.17, 0.10), (0.20, 0.095, 0.055), (0.09, 0.042, 0.026))
"""Linear red, green and blue of skins, light to dark; chosen by hand."""
_HAIRS = ((0.012, 0.009, 0.008), (0.035, 0.018, 0.01), (0.11, 0.055, 0.025), (0.33, 0.2, 0.08), (0.25, 0.24, 0.24))
"""The same of hair."""
_PATTERNS = ("plain", "plain", "stripes", "upright", "checks", "blocks")


def linear(hue: float, saturation: float, value: float) -> np.ndarray:
    """Return a colour as (3,) linear RGB."""
    return np.array(colorsys.hsv_to_rgb(hue, saturation, value)) ** 2.2


def painted_material(name: str, roughness: float) -> bpy.types.Material:
    """Return a material that shows its mesh's corner colours."""
    material = bpy.data.materials.new(name)
    if bpy.app.version < (5, 0):
        material.use_nodes = True
    tree = material.node_tree
    shader = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeBsdfPrincipled")
    shader.inputs["Roughness"].default_value = roughness
    paint = tree.nodes.new("ShaderNodeAttribute")
    paint.attribute_name = COLOURS
    tree.links.new(paint.outputs["Color"], shader.inputs["Base Color"])
    return material


def person_colours(scene: SceneFile, rng: np.random.Generator) -> np.ndarray:
    """Return the (3 T, 3) linear colours of the corners of a dressed person's triangles."""
    tone = np.array(_SKINS[rng.integers(len(_SKINS))]) * rng.uniform(0.85, 1.15)
    strand = np.array(_HAIRS[rng.integers(len(_HAIRS))]) * rng.uniform(0.8, 1.2)
    corner = scene.faces.ravel()
    label = np.repeat(scene.label, 3)
    colours = np.zeros((len(corner), 3))
    for index, name in enumerate(scene.labels):
        chosen = label == index
        if not chosen.any():
            continue
        rest = scene.rest[corner[chosen]]
        if name == "skin":
            colours[chosen] = _skin(tone, rest)
        elif name == "hair":
            colours[chosen] = strand * (1 + 0.5 * np.sin(rest @ rng.normal(size=3) * 260))[:, None] * 0.8
        elif name == "shoes":
            colours[chosen] = linear(rng.random(), 0.3, rng.uniform(0.1, 0.8))
        else:
            colours[chosen] = _cloth(rest, rng, plain=name == "suit")
    return np.clip(colours, 0.002, 0.95)


def _skin(tone: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """Return skin that is a little redder and darker here and there."""
    blotch = np.sin(rest[:, 0] * 31 + 2) * np.sin(rest[:, 1] * 27) * np.sin(rest[:, 2] * 29 + 1)
    return tone * (1 + 0.06 * blotch[:, None] * [0.3, 1.0, 1.0])


def _cloth(rest: np.ndarray, rng: np.random.Generator, *, plain: bool) -> np.ndarray:
    """Return the colours of a garment at (n, 3) places of the resting body."""
    base = linear(rng.random(), rng.uniform(0.15, 0.8), rng.uniform(0.2, 0.9))
    other = linear(rng.random(), rng.uniform(0.0, 0.7), rng.uniform(0.15, 0.95))
    pattern = "plain" if plain else _PATTERNS[rng.integers(len(_PATTERNS))]
    length = rng.uniform(0.05, 0.1)
    up, across = np.sin(2 * np.pi * rest[:, 1] / length) > 0, np.sin(2 * np.pi * rest[:, 0] / length) > 0
    middle = np.median(rest[:, 1])
    mix = {
        "plain": np.zeros(len(rest)), "stripes": up * 1.0, "upright": across * 1.0, "checks": 0.5 * up + 0.5 * across,
        "blocks": (rest[:, 1] > middle) * 1.0,
    }[pattern][:, None]  # fmt: skip
    return base * (1 - mix) + other * mix
