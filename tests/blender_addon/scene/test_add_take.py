"""Takes of one body share its armature; a take of another body gets one of its own."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import bpy
import numpy as np

from blender_addon.body.shape import body_mesh, get_betas
from blender_addon.scene.bake import BakedTake, add_take


def test_takes_of_one_body_share_it_and_its_sliders_follow(scene: bpy.types.Scene, take: BakedTake, files: Any) -> None:
    motion = replace(files.motion, betas=np.linspace(-1, 1, 10))
    armature, action = add_take(scene, "second", motion, files.body, take.armature, None, 1)
    assert armature is take.armature and action is not take.action
    np.testing.assert_allclose(get_betas(take.mesh), motion.betas, atol=1e-6)


def test_a_take_of_another_body_gets_its_own(scene: bpy.types.Scene, take: BakedTake, files: Any) -> None:
    motion, body = replace(files.motion, body="other"), replace(files.body, id="other")
    armature, action = add_take(scene, "second", motion, body, take.armature, None, 1)
    assert armature is not take.armature and body_mesh(armature) is not take.mesh
    assert armature.animation_data.action is action and take.armature.animation_data.action is take.action
