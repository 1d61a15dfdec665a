"""Limbs from FK to IK and back: the motion is kept, whatever the frame rate, the shape and the root's place."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest

from blender_addon._exchange.errors import BodyInvalid
from blender_addon.animation.curves import action_curves, relay_take
from blender_addon.body.body_file import BodyFile
from blender_addon.body.controls.limbs import CONTROLS, LIMBS, ROOT, has_limbs, switch_path
from blender_addon.body.rig import Rig
from blender_addon.body.shape import sliders
from blender_addon.conventions.skeleton import JOINTS
from blender_addon.conventions.timing import go_to_frame
from blender_addon.scene.bake import BakedTake, BakeSettings, bake_take
from blender_addon.scene.limb_modes import frames_of, pole_places, pose_by_joints, pose_from_ends
from tests.support.addon_stand_in import Files
from tests.support.posed_rig import evaluated, pose

_JOINTS_M, _DEGREES = 2e-4, 0.1  # What of the motion may be lost: the task allows 1 mm.


def _motion(scene: bpy.types.Scene, armature: bpy.types.Object, times: np.ndarray) -> np.ndarray:
    """Return (F, 24, 4, 4) matrices of the joints in the world."""
    found = np.empty((len(times), len(JOINTS), 4, 4))
    for f, time in enumerate(times):
        go_to_frame(scene, float(time))
        shown = armature.evaluated_get(bpy.context.evaluated_depsgraph_get())
        found[f] = [shown.matrix_world @ shown.pose.bones[joint].matrix for joint in JOINTS]
    return found


def _apart(a: np.ndarray, b: np.ndarray) -> tuple[float, float]:
    """Return the largest distance in metres and angle in degrees of two motions."""
    metres = np.linalg.norm(a[..., :3, 3] - b[..., :3, 3], axis=-1).max()
    R = a[..., :3, :3].swapaxes(-1, -2) @ b[..., :3, :3]
    sine = np.stack([R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], -1)
    return float(metres), float(np.degrees(np.arcsin(np.clip(np.linalg.norm(sine, axis=-1) / 2, 0, 1)).max()))


def _moves(armature: bpy.types.Object, path: str) -> np.ndarray:
    """Return the (F,) keyed values of the first curve of a path."""
    curve = next(c for c in action_curves(armature.animation_data.action) if c.data_path == path)
    return np.array([key.co.y for key in curve.keyframe_points])


@pytest.mark.slow
@pytest.mark.parametrize("scene_fps", [24.0, 60.0])
def test_there_and_back_keeps_the_motion(scene: bpy.types.Scene, files: Files, scene_fps: float) -> None:
    scene.render.fps = round(scene_fps)
    settings = BakeSettings(frame_start=7, set_scene=False)
    armature = bake_take(scene, files.motion, files.body, settings=settings).armature
    times = frames_of(armature.animation_data.action)
    assert len(times) == files.motion.num_frames
    solved = _motion(scene, armature, times)
    assert pose_from_ends(armature, scene, LIMBS) == len(times)
    assert {armature.pose.bones[ROOT][limb.switch] for limb in LIMBS} == {1.0}
    metres, degrees = _apart(_motion(scene, armature, times), solved)
    assert metres < _JOINTS_M and degrees < _DEGREES
    for limb in LIMBS:  # what FK says no longer matters
        for joint in limb.joints:
            for curve in action_curves(armature.animation_data.action):
                if curve.data_path == f'pose.bones["{joint}"].rotation_quaternion':
                    curve.mute = True
    metres, degrees = _apart(_motion(scene, armature, times), solved)
    assert metres < _JOINTS_M and degrees < _DEGREES
    assert pose_by_joints(armature, scene, LIMBS) == len(times)
    metres, degrees = _apart(_motion(scene, armature, times), solved)
    assert metres < _JOINTS_M and degrees < _DEGREES
    assert {armature.pose.bones[ROOT][limb.switch] for limb in LIMBS} == {0.0}


def test_real_shapes_and_a_root_that_was_moved(scene: bpy.types.Scene, files: Files, body: BodyFile) -> None:
    motion = replace(files.motion, body=body.id, betas=np.linspace(-1.5, 1.5, 10), joints=None)
    armature = bake_take(scene, motion, body).armature
    root = armature.pose.bones[ROOT]
    root.location, root.rotation_quaternion = (2.0, -1.0, 0.5), (np.cos(0.4), 0.0, np.sin(0.4), 0.0)
    mesh = next(child for child in armature.children if child.type == "MESH")
    for key, value in zip(sliders(mesh), np.linspace(1.0, -1.0, 10).tolist(), strict=True):
        key.value = value  # another shape than that the armature was laid out for
    times = frames_of(armature.animation_data.action)[::6]
    solved = _motion(scene, armature, times)
    assert abs(solved[0, 0, 0, 3] - motion.transl[0, 0]) > 1.0
    pose_from_ends(armature, scene, LIMBS)
    metres, degrees = _apart(_motion(scene, armature, times), solved)
    assert metres < _JOINTS_M and degrees < _DEGREES


def test_hands_and_feet_stay_where_they_are_put(scene: bpy.types.Scene, rig: Rig) -> None:
    rng = np.random.default_rng(5)
    pose(rig, 0.2 * rng.normal(size=(24, 3)))
    for limb in LIMBS:
        rig.armature.pose.bones[limb.joints[1]].rotation_quaternion = (np.cos(0.4), np.sin(0.4), 0.05, -0.05)
    before, _ = evaluated(rig)
    assert pose_from_ends(rig.armature, scene, LIMBS) == 0
    np.testing.assert_allclose(evaluated(rig)[0], before, atol=_JOINTS_M)
    rig.armature.pose.bones["pelvis"].location = (0.03, -0.06, 0.02)
    joints, _ = evaluated(rig)
    ends = [JOINTS.index(limb.joints[2]) for limb in LIMBS]
    assert np.linalg.norm(joints[0] - before[0]) == pytest.approx(0.07, abs=1e-3)
    assert np.linalg.norm(joints[ends] - before[ends], axis=-1).max() < 0.01


def test_one_limb_alone_and_another_action(scene: bpy.types.Scene, take: BakedTake, files: Files) -> None:
    leg = LIMBS[2]
    pose_from_ends(take.armature, scene, [leg])
    assert [take.armature.pose.bones[ROOT][limb.switch] for limb in LIMBS] == [0.0, 0.0, 1.0, 0.0]
    shown = {c.name for c in take.armature.data.collections if c.is_visible}
    assert leg.collection in shown and LIMBS[3].collection not in shown
    assert _moves(take.armature, switch_path(leg)).tolist() == [1.0]
    assert len(_moves(take.armature, f'pose.bones["{leg.pole}"].location')) == files.motion.num_frames


def test_limb_keys_follow_the_scenes_rate(scene: bpy.types.Scene, take: BakedTake) -> None:
    times = frames_of(take.action)
    solved = _motion(scene, take.armature, times[::7])
    pose_from_ends(take.armature, scene, LIMBS)
    relay_take(take.action, 2 * float(take.action["fps"]))
    later = frames_of(take.action)
    assert len(later) == len(times) and np.diff(later) == pytest.approx(2.0, abs=1e-4)
    metres, degrees = _apart(_motion(scene, take.armature, later[::7]), solved)
    assert metres < _JOINTS_M and degrees < _DEGREES


def test_poles_turn_smoothly_where_a_limb_is_stretched() -> None:
    bend = np.linspace(0.3, -0.01, 60)  # through straight, a little beyond
    hip, ankle = np.zeros((60, 3)), np.tile([0.0, 0.0, -0.8], (60, 1))
    knee = np.stack([0 * bend, -0.4 * np.sin(bend), -0.4 * np.cos(bend)], -1)
    ahead = np.stack([0 * bend, -np.cos(bend), np.sin(bend)], -1)
    places = pole_places(hip, knee, ankle, ahead)
    assert (places[:, 1] < -0.3).all()
    assert np.linalg.norm(np.diff(places, axis=0), axis=-1).max() < 0.01
    assert np.isfinite(pole_places(hip, hip, hip, ahead)).all()


def test_a_body_without_controls_is_named(scene: bpy.types.Scene, rig: Rig) -> None:
    del rig.armature.pose.bones[ROOT][LIMBS[0].switch]
    assert not has_limbs(rig.armature) and not has_limbs(None) and not has_limbs(rig.mesh)
    with pytest.raises(BodyInvalid, match="no controls for hands and feet"):
        pose_from_ends(rig.armature, scene, LIMBS)


def test_a_linked_action_is_left_alone(scene: bpy.types.Scene, take: BakedTake, tmp_path: Path) -> None:
    library = str(tmp_path / "actions.blend")
    bpy.data.libraries.write(library, {take.action})
    with bpy.data.libraries.load(library, link=True) as (_, wanted):
        wanted.actions = [take.action.name]
    linked: Any = next(action for action in bpy.data.actions if action.library is not None)
    take.armature.animation_data.action = linked
    with pytest.raises(BodyInvalid, match="cannot be changed"):
        pose_from_ends(take.armature, scene, LIMBS)
    assert take.armature.pose.bones[ROOT][LIMBS[0].switch] == 0.0


def test_controls_are_seen_only_as_controls(rig: Rig) -> None:
    bpy.context.view_layer.update()
    for name in (ROOT, *CONTROLS):
        shape = rig.armature.pose.bones[name].custom_shape
        assert shape is not None and not shape.data.polygons
        assert not shape.visible_get() and not shape.select_get()
        assert all(folder.hide_render and folder.hide_viewport for folder in shape.users_collection)
