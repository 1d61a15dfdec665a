"""The shape sliders by number, whatever their names state that they do, and the skin that has them."""

from __future__ import annotations

import bpy

from ..conventions.skeleton import NUM_BETAS

_PREFIX = "Shape"
LOOK_KEY = "Mannequin"
"""Name of the shape key that takes the face away."""


def slider_name(index: int, effect: str = "") -> str:
    """Return the name of the shape key of one beta, "Shape 0 stature"; earlier versions left the effect out."""
    return f"{_PREFIX} {index} {effect}".rstrip()


def sliders(mesh: bpy.types.Object) -> list[bpy.types.ShapeKey]:
    """Return the ten sliders in the order of the betas, fewer where the object lacks some."""
    keys = getattr(mesh.data, "shape_keys", None)
    found: dict[int, bpy.types.ShapeKey] = {}
    for key in keys.key_blocks if keys is not None else ():
        words = key.name.split()
        if len(words) > 1 and words[0] == _PREFIX and words[1].isdecimal():
            found.setdefault(int(words[1]), key)
    return [found[k] for k in range(NUM_BETAS) if k in found]


def effect_of(key: bpy.types.ShapeKey) -> str:
    """Return what a slider does, "Stature"; its whole name in files of earlier versions."""
    words = key.name.split(maxsplit=2)
    return words[2].capitalize() if len(words) > 2 else key.name


def look_key(mesh: bpy.types.Object) -> bpy.types.ShapeKey | None:
    """Return the shape key that takes the face away, None where the body has none."""
    keys = getattr(mesh.data, "shape_keys", None)
    return None if keys is None else keys.key_blocks.get(LOOK_KEY)


def body_mesh(armature: bpy.types.Object) -> bpy.types.Object | None:
    """Return the skin of a body, None if it was deleted."""
    return next((child for child in armature.children if child.type == "MESH" and child.data.shape_keys), None)
