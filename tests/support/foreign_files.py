"""The characters of other programs that retargeting is measured on, each as a file that its program's users have."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import bpy

from blender_addon.retarget.scene_files import open_scene
from tests.support.foreign_characters import write_character
from tests.support.foreign_namings import NAMINGS
from tests.support.foreign_rigs import limbs_of
from tests.support.foreign_skeletons import draw
from tests.support.retarget_measures import Limb

Opened = tuple[bpy.types.Object, dict[str, Limb]]


def _opened(folder: Path, name: str, naming: str, arms_down_deg: float, legs: float = 1.0, unit: float = 1.0) -> Opened:
    """Write a character, open it again, and return its armature and limbs."""
    skeleton = draw(NAMINGS[naming], arms_down_deg, legs)
    scene = open_scene(write_character(folder / name, skeleton, unit=unit))
    return next(o for o in scene.objects if o.type == "ARMATURE"), limbs_of(skeleton.roles)


CHARACTERS: dict[str, Callable[[Path], Opened]] = {
    "xbot_glb": partial(_opened, name="xbot.glb", naming="mixamo", arms_down_deg=0.0),
    "unreal_fbx": partial(_opened, name="mannequin.fbx", naming="unreal_5", arms_down_deg=45.0, legs=1.06),
    "avatar_001": partial(_opened, name="avatar.blend", naming="ready_player_me", arms_down_deg=0.0, unit=0.01),
    "avatar_glb": partial(_opened, name="avatar.glb", naming="ready_player_me", arms_down_deg=60.0, legs=1.0),
    "vrm": partial(_opened, name="own_names.vrm", naming="vrm_own_names", arms_down_deg=10.0, legs=0.93),
    "vroid_fbx": partial(_opened, name="vroid.fbx", naming="vroid", arms_down_deg=0.0),
    "makehuman": partial(_opened, name="makehuman.blend", naming="makehuman", arms_down_deg=40.0),
    "rigify_deform_glb": partial(_opened, name="game.glb", naming="rigify_deform", arms_down_deg=30.0),
}  # fmt: skip
