"""A rig that is linked from another file: refused with what to do, and played once it is a library override."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
import pytest

from blender_addon.body.body_file import default_body_path, read_body
from blender_addon.conventions.timing import TakeTiming
from blender_addon.errors import TargetUnsuitable
from blender_addon.retarget.motion.figures import Actor, actor_of_motion
from blender_addon.retarget.recognition import map_rig
from blender_addon.retarget.retarget import retarget
from tests.support.foreign_namings import NAMINGS
from tests.support.foreign_rigs import foreign_rig
from tests.support.foreign_skeletons import draw
from tests.support.grasping_hand import grasping


def actor() -> Actor:
    motion = grasping(0.9)
    motion.rotvec[:, 16, 2] = np.linspace(0.0, -1.2, len(motion.rotvec))
    return actor_of_motion(motion, read_body(default_body_path(), motion.body_layout))


def heads(rig: bpy.types.Object) -> np.ndarray:
    bpy.context.scene.frame_set(4)
    bones = rig.evaluated_get(bpy.context.evaluated_depsgraph_get()).pose.bones
    return np.array([bone.head for bone in bones])


def test_a_linked_rig_is_refused_and_its_override_plays_as_a_local_one(scene: bpy.types.Scene, tmp_path: Path) -> None:
    rig, _ = foreign_rig(draw(NAMINGS["mixamo"]))
    library = tmp_path / "rig.blend"
    bpy.data.libraries.write(str(library), {rig})
    scene.render.fps = 30
    retarget(actor(), rig, scene, map_rig(rig), TakeTiming(1, 30.0))
    local, name = heads(rig), rig.name
    bpy.data.objects.remove(rig)
    with bpy.data.libraries.load(str(library), link=True) as (_, wanted):
        wanted.objects = [name]
    linked = wanted.objects[0]
    scene.collection.objects.link(linked)
    with pytest.raises(TargetUnsuitable, match="linked") as refused:
        retarget(actor(), linked, scene, map_rig(linked), TakeTiming(1, 30.0))
    assert "override" in refused.value.hint.lower() and linked.animation_data is None
    override = linked.override_create(remap_local_usages=True)
    done = retarget(actor(), override, scene, map_rig(override), TakeTiming(1, 30.0))
    assert override.library is None and done.action.library is None
    np.testing.assert_allclose(heads(override), local, atol=1e-4)
    assert np.abs(local - np.array([bone.head_local for bone in override.data.bones])).max() > 0.3, "it moves"
