"""The characters of other programs that retargeting is measured on, each as a file that its program's users have."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import bpy

from blender_addon.retarget.recognition import open_scene
from tests.support.foreign_characters import write_character
from tests.support.foreign_namings import NAMINGS
from tests.support.foreign_rigs import limbs_of
from tests.support.foreign_skeletons import ForeignSkeleton, draw
from tests.support.retarget_measures import Limb

Opened = tuple[bpy.types.Object, dict[str, Limb]]


@dataclass(frozen=True)
class Character:
    """A character and its file."""

    file: str
    naming: str
    arms_down_deg: float = 0.0
    legs: float = 1.0
    unit: float = 1.0
    """Scale of its armature."""

    @property
    def skeleton(self) -> ForeignSkeleton:
        """Its bones."""
        return draw(NAMINGS[self.naming], self.arms_down_deg, self.legs)

    @property
    def limbs(self) -> dict[str, Limb]:
        """The bones that show its limbs."""
        return limbs_of(self.skeleton.roles)

    def write(self, folder: Path) -> Path:
        """Write it; what was open is lost."""
        return write_character(folder / self.file, self.skeleton, unit=self.unit)

    def __call__(self, folder: Path) -> Opened:
        """Write it, open it again in a scene of its own, and return its armature and limbs."""
        scene = open_scene(self.write(folder))
        return next(o for o in scene.objects if o.type == "ARMATURE"), self.limbs


CHARACTERS = {
    "xbot_glb": Character("xbot.glb", "mixamo"),
    "unreal_fbx": Character("mannequin.fbx", "unreal_5", arms_down_deg=45.0, legs=1.06),
    "avatar_001": Character("avatar.blend", "ready_player_me", unit=0.01),
    "avatar_glb": Character("avatar.glb", "ready_player_me", arms_down_deg=60.0),
    "vrm": Character("own_names.vrm", "vrm_own_names", arms_down_deg=10.0, legs=0.93),
    "vroid_fbx": Character("vroid.fbx", "vroid"),
    "makehuman": Character("makehuman.blend", "makehuman", arms_down_deg=40.0),
    "rigify_deform_glb": Character("game.glb", "rigify_deform", arms_down_deg=30.0),
}
