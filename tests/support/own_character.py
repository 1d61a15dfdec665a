"""Our body, made broader, as a skinned character of another program."""

from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np

from blender_addon.body.body_file import BodyFile
from blender_addon.conventions.coordinates import R_ARMATURE_BODY
from tests.support.foreign_rigs import foreign_rig
from tests.support.own_skeleton import own_skeleton


def own_character(body: BodyFile, broader: float, shoulders: float, arms: float = 1.0) -> bpy.types.Object:
    """Build a Mixamo-named armature with our body's skin, but broader.

    Legs keep their lengths; legs and arms begin further out.

    Args:
        body: whose joints and skin.
        broader: breadth and depth of trunk, head, thighs and shins, and breadth of the hips, by the body's.
        shoulders: breadth of the shoulders by the body's.
        arms: length of the arms by the body's.
    """
    betas = np.zeros(body.shapedirs.shape[-1])
    skeleton = own_skeleton(body, betas)
    skin = body.shaped(betas) @ R_ARMATURE_BODY.T
    skin = skin - [0.0, 0.0, skin[:, 2].min()]
    names, followed = list(skeleton.heads), body.weights.argmax(axis=1)
    heads = np.array([skeleton.heads[name] for name in names])
    # What begins at a limb's root is shifted as a whole, so that its own thickness stays.
    starts = np.array([_root_of(name, names) for name in names])
    breadth = np.array([shoulders if "Arm" in names[start] else broader for start in starts])
    shift = (breadth - 1.0)[:, None] * heads[starts] * [1.0, 0.0, 0.0]
    armed = np.array(["Arm" in names[start] for start in starts])
    shift += np.where(armed[:, None], (arms - 1.0) * (heads - heads[starts]), 0.0)
    own = skin - heads[followed]
    thick = np.array([broader if _is_thickened(name) else 1.0 for name in names])[followed, None]
    scaled = own * np.where(np.arange(3) == 2, 1.0, thick)
    points = heads[followed] + shift[followed] + scaled
    moved = dict(zip(names, heads + shift, strict=True))
    rig, _ = foreign_rig(replace(skeleton, heads=moved))
    mesh = bpy.data.meshes.new("Skin")
    mesh.from_pydata(points.tolist(), [], body.faces.tolist())
    skin_of = bpy.data.objects.new("Skin", mesh)
    bpy.context.scene.collection.objects.link(skin_of)
    for j, name in enumerate(names):
        group = skin_of.vertex_groups.new(name=name)
        group.add(np.flatnonzero(followed == j).tolist(), 1.0, "REPLACE")
    skin_of.modifiers.new("Armature", "ARMATURE").object = rig
    bpy.context.view_layer.update()
    return rig


def _root_of(name: str, names: list[str]) -> int:
    """Return the bone with which the shift of a bone is decided: the upper arm or thigh of its limb, else itself."""
    prefix = name[: name.index(":") + 1]
    for side in ("Left", "Right"):
        if side in name:
            part = "UpLeg" if any(word in name for word in ("Leg", "Foot", "Toe")) else "Arm"
            if name.endswith("Shoulder"):
                return names.index(name)
            return names.index(f"{prefix}{side}{part}")
    return names.index(name)


def _is_thickened(name: str) -> bool:
    return not any(word in name for word in ("Arm", "Hand", "Foot", "Toe"))
