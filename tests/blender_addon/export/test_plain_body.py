"""The plain copy stands, is shaped and moves as the body does, on 24 bones and without helpers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from blender_addon._exchange.motion_file import MotionFile
from blender_addon.animation.deviation import evaluated_joints, evaluated_vertices
from blender_addon.body.body_file import BodyFile, skin
from blender_addon.body.mesh import positions
from blender_addon.body.rig import Rig
from blender_addon.body.shape import set_betas
from blender_addon.conventions.skeleton import JOINTS
from blender_addon.export.plain_take import plain_copy
from blender_addon.export.take import take_of
from blender_addon.export.write import export_take
from blender_addon.scene.bake import BakedTake, bake_take
from tests.support.posed_rig import evaluated, pose


def test_reshaped_body_is_copied_as_it_stands(scene: bpy.types.Scene, rig: Rig, body: BodyFile) -> None:
    rng = np.random.default_rng(0)
    betas, rotvec = rng.normal(size=10), 0.5 * rng.normal(size=(24, 3))
    set_betas(rig.mesh, betas)
    bpy.context.view_layer.update()
    copy = Rig(*plain_copy(rig.armature, rig.mesh, scene.collection))
    assert sorted(copy.armature.data.bones.keys()) == sorted(JOINTS)
    assert copy.mesh.data.shape_keys is None and copy.armature.animation_data is None
    assert sorted(group.name for group in copy.mesh.vertex_groups) == sorted(JOINTS)
    assert all(bone.use_deform for bone in copy.armature.data.bones)
    pelvis = np.array(rig.armature.data.bones["pelvis"].head_local)
    motion = MotionFile("pose", rotvec[None], pelvis - body.rest_joints(betas)[:1], betas, fps=30.0)
    for each in (rig, copy):
        pose(each, rotvec)
    joints, vertices = evaluated(copy)
    np.testing.assert_allclose(joints, evaluated(rig)[0], atol=1e-4)
    # Blender 5.0 does not write driven changes below 1e-4.
    expected = skin(replace(body, posedirs=None), motion, [0])[0]
    np.testing.assert_allclose(vertices, expected, atol=1e-4 if bpy.app.version < (5, 0) else 5e-4)


def test_copy_of_a_take_plays_its_action(scene: bpy.types.Scene, take: BakedTake, files: Any) -> None:
    copy = Rig(*plain_copy(take.armature, take.mesh, take.body))
    assert copy.armature.animation_data.action is take.action
    plain = replace(files.body, posedirs=None)
    for frame in (0, 31, 59):
        np.testing.assert_allclose(
            evaluated_joints(scene, copy.armature, frame + 1), files.motion.joints[frame], atol=1e-4
        )
        expected = skin(plain, files.motion, [frame])[0]
        np.testing.assert_allclose(evaluated_vertices(scene, copy.mesh, frame + 1), expected, atol=1e-4)


def test_the_body_itself_is_left_alone(scene: bpy.types.Scene, files: Any) -> None:
    take = bake_take(scene, files.motion, files.body)
    keys, bones = len(take.mesh.data.shape_keys.key_blocks), len(take.armature.data.bones)
    before = evaluated_vertices(scene, take.mesh, 20)
    plain_copy(take.armature, take.mesh, take.body)
    assert (len(take.mesh.data.shape_keys.key_blocks), len(take.armature.data.bones)) == (keys, bones)
    np.testing.assert_array_equal(evaluated_vertices(scene, take.mesh, 20), before)


def test_an_exporter_evaluates_the_body_alone(scene: bpy.types.Scene, take: BakedTake, tmp_path: Path) -> None:
    """It visits each frame, and would evaluate all other characters of the user's scene there."""
    seen: list[str] = []

    def note(shown: bpy.types.Scene, *_: object) -> None:
        seen.append(shown.name)

    bpy.app.handlers.frame_change_post.append(note)
    try:
        export_take(take_of(scene, take.armature), "fbx", tmp_path / "walk.fbx")
    finally:
        bpy.app.handlers.frame_change_post.remove(note)
    assert len(seen) >= 120 and scene.name not in seen
    assert list(bpy.data.scenes) == [scene]


def test_keys_of_the_user_keep_their_basis_and_their_group(scene: bpy.types.Scene, rig: Rig) -> None:
    raised, more = (rig.mesh.shape_key_add(name=name, from_mix=False) for name in ("raised", "more"))
    for key, height in ((raised, 0.1), (more, 0.3)):
        for point in key.points:
            point.co.z += height
    more.relative_key, half = raised, rig.mesh.vertex_groups.new(name="half")
    half.add(list(range(100)), 0.5, "REPLACE")
    more.vertex_group = half.name
    copy = Rig(*plain_copy(rig.armature, rig.mesh, scene.collection))
    keys = copy.mesh.data.shape_keys.key_blocks
    rest, found = (positions(keys[name].points)[:, 2] for name in ("Basis", "more"))
    np.testing.assert_allclose(found - rest, np.where(np.arange(len(rest)) < 100, 0.1, 0.0), atol=1e-6)
