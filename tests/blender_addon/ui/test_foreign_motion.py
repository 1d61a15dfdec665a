"""Motions of other programs onto our body by the buttons: from files, and from an armature of the scene."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
import pytest

from blender_addon._exchange.motion_file import MotionFile, read_motion
from blender_addon._exchange.stands import stands, steps
from blender_addon.animation.curves import action_curves, current_action
from blender_addon.animation.deviation import evaluated_joints
from blender_addon.body.body_file import default_body_path, read_body
from blender_addon.retarget.motion.figures import actor_of_motion
from blender_addon.retarget.rig_actor import read_actor
from blender_addon.review.ranges import sole_height
from blender_addon.ui.operators.base import current
from blender_addon.ui.operators.imports import remarks
from solver_backend.body.body import load_body
from tests.support.bvh_texts import known_motion, write_bvh
from tests.support.foreign_characters import skinned_rig
from tests.support.narrow_layout import draw_panel
from tests.support.own_skeleton import own_skeleton
from tests.support.played_character import FRAMES, known_clip, play_on_character, write_clip

INSIDE_HANDS = 22  # First of the joints that are not SMPL's to turn.
BALLS, FPS = (10, 11), 30.0  # Of the feet, among SMPL's joints; frames a second of the clips.


def joints_of(armature: bpy.types.Object) -> np.ndarray:
    return read_actor(armature, bpy.context.scene)[0].joints[:, :INSIDE_HANDS]


def joints_of_motion(motion: MotionFile) -> np.ndarray:
    return actor_of_motion(motion, read_body(default_body_path())).joints[:, :INSIDE_HANDS]


def distance_mm(a: np.ndarray, b: np.ndarray) -> float:
    return 1000.0 * float(np.linalg.norm(a - b, axis=-1).max())


def test_a_bvh_arrives_as_a_body(mocap: bpy.types.PropertyGroup, tmp_path: Path) -> None:
    known = known_motion(load_body(), np.zeros(10), FRAMES)
    clip = write_bvh(tmp_path / "Gang [1].bvh", known)
    assert bpy.ops.mocap.import_motion(filepath=str(clip), scene_setup="TAKE", keep_height=True) == {"FINISHED"}
    body = mocap.review.armature
    assert body is not None and mocap.stage == "EDIT" and mocap.review.take == current_action(body)
    assert distance_mm(joints_of(body), known.posed.joints[:, :INSIDE_HANDS]) < 10.0
    assert bpy.context.scene.frame_end == FRAMES and bpy.context.scene.render.fps == 30
    files = sorted(path.name for path in Path(mocap.folder).iterdir())
    assert files == ["Gang [1]_01.npz"]
    assert bpy.ops.mocap.import_motion(filepath=str(clip)) == {"FINISHED"}
    assert sorted(path.name for path in Path(mocap.folder).iterdir()) == ["Gang [1]_01.npz", "Gang [1]_02.npz"]


@pytest.mark.slow
def test_a_character_of_another_program_arrives_as_a_body(mocap, scene, tmp_path: Path) -> None:
    motion = known_clip()
    play_on_character(motion, scene)
    clip = write_clip(tmp_path / "walk.glb")
    before = {obj.name for obj in scene.objects}
    with pytest.raises(RuntimeError, match="There is no action 'run'"):
        bpy.ops.mocap.import_motion(filepath=str(clip), clip="run")
    assert {obj.name for obj in scene.objects} == before, "nothing is half-done"
    options = {"scene_setup": "KEEP", "keep_height": True, "floor": False}
    assert bpy.ops.mocap.import_motion(filepath=str(clip), **options) == {"FINISHED"}
    assert distance_mm(joints_of(mocap.review.armature), joints_of_motion(motion)) < 2.0
    assert before < {obj.name for obj in scene.objects}, "the file was opened elsewhere"


def test_warnings_of_a_clip_are_reported_before_its_notes_and_once() -> None:
    """The solver's own result keeps them apart; that of the command that opens Blender's formats repeats them."""
    assert remarks({"problems": ["no arms"], "notes": ["unit cm"]}) == ("no arms", "unit cm")
    assert remarks({"problems": ["no arms"], "notes": ["no arms", "unit cm"]}) == ("no arms", "unit cm")


def test_what_is_wrong_with_a_clip_stands_in_the_panel(mocap, tmp_path: Path) -> None:
    clip = tmp_path / "chair.bvh"
    clip.write_text("HIERARCHY\nROOT seat\n{\nOFFSET 0 0 0\nCHANNELS 3 Zrotation Xrotation Yrotation\n"
                    "End Site\n{\nOFFSET 0 1 0\n}\n}\nMOTION\nFrames: 1\nFrame Time: 0.03\n0 0 0\n")  # fmt: skip
    with pytest.raises(RuntimeError, match="No joints were found"):
        bpy.ops.mocap.import_motion(filepath=str(clip))
    assert current.last is not None and current.last.verb == "motion convert"
    drawn = " ".join(draw_panel(bpy.types.VIEW3D_PT_mocap_run, 283).drawn)
    assert "No joints were found" in drawn
    assert not bpy.data.objects and not list(Path(mocap.folder).glob("*.npz"))


def test_what_a_rig_of_the_scene_plays_arrives_on_our_body(mocap, scene) -> None:
    motion = known_clip()
    rig = play_on_character(motion, scene)
    rig.location = (1.0, 2.0, 0.0)
    mocap.retarget.actor = rig
    mocap.stage = "DELIVER"
    assert "Bring onto Body" in draw_panel(bpy.types.VIEW3D_PT_mocap_retarget, 283).drawn
    played = current_action(rig)
    assert bpy.ops.mocap.motion_from_rig() == {"FINISHED"}
    body = mocap.review.armature
    assert current_action(rig) == played and body != rig
    found, wanted = joints_of(body), joints_of_motion(motion) + [1.0, 2.0, 0.0]
    assert distance_mm(found[..., :2], wanted[..., :2]) < 2.0
    assert np.ptp(found[..., 2] - wanted[..., 2]) < 0.002, "only the floor differs"
    assert current_action(body).frame_range[:] == played.frame_range[:]
    assert [path.suffixes for path in Path(mocap.folder).iterdir()] == [[".npz"]], "the skeleton file is gone"
    mocap.retarget.actor = None
    bpy.context.view_layer.objects.active = body
    assert not bpy.ops.mocap.motion_from_rig.poll(), "our own body needs no fit"


def test_a_rig_that_plays_nothing_is_named(mocap, scene) -> None:
    mocap.retarget.actor = skinned_rig(own_skeleton(read_body(default_body_path()), np.zeros(10)))
    with pytest.raises(RuntimeError, match="has no action"):
        bpy.ops.mocap.motion_from_rig()
    assert not Path(mocap.folder).exists() or not list(Path(mocap.folder).iterdir())


@pytest.mark.slow
def test_a_foreign_clip_is_edited_like_a_take_of_our_own(mocap, scene, tmp_path: Path) -> None:
    clip = write_bvh(tmp_path / "clip.bvh", known_motion(load_body(), np.zeros(10), FRAMES))
    assert bpy.ops.mocap.import_motion(filepath=str(clip), scene_setup="TAKE") == {"FINISHED"}
    body, action = mocap.review.armature, mocap.review.take
    contacts = read_motion(next(Path(mocap.folder).glob("*.npz"))).contacts
    assert contacts is not None and contacts.any() and not contacts.all(), "feet that stand are known"
    full = np.stack([evaluated_joints(scene, body, frame) for frame in range(1, FRAMES + 1)])
    assert bpy.ops.mocap.thin_take(by="TOLERANCE", tolerance_mm=10.0) == {"FINISHED"}
    few = np.stack([evaluated_joints(scene, body, frame) for frame in range(1, FRAMES + 1)])
    assert 1000 * np.linalg.norm(few - full, axis=-1).max() < 10.1
    assert len(next(iter(action_curves(mocap.review.take))).keyframe_points) < FRAMES
    mocap.review.floor_offset = 0.05
    assert bpy.ops.mocap.feet_to_floor() == {"FINISHED"}
    assert abs(sole_height(scene, body, action, 1 + FRAMES // 2)) < 0.02


def test_feet_of_a_foreign_clip_are_locked_with_edits_kept(mocap, scene, tmp_path: Path) -> None:
    """A clip that skates by 25 mm: its stands hold, the arm that was edited stays, no other joint leaves its place."""
    clip = write_bvh(tmp_path / "clip.bvh", known_motion(load_body(), np.zeros(10), FRAMES))
    assert bpy.ops.mocap.import_motion(filepath=str(clip), scene_setup="TAKE") == {"FINISHED"}
    body, former = mocap.review.armature, mocap.review.take
    location = next(curve for curve in action_curves(former) if curve.data_path == 'pose.bones["pelvis"].location')
    for point in location.keyframe_points:
        point.co.y += 0.025 * np.sin(2 * np.pi * point.co.x / 40)
    elbow = next(curve for curve in action_curves(former) if "left_elbow" in curve.data_path and curve.array_index == 1)
    for point in elbow.keyframe_points:
        point.co.y += 0.3
    before, stood = joints_of(body), ball_stands(body)
    assert slid_mm(before, stood) > 25.0
    assert "Lock Feet" in draw_panel(bpy.types.VIEW3D_PT_mocap_clean_up, 283).drawn
    assert bpy.ops.mocap.lock_feet() == {"FINISHED"}
    locked = mocap.review.take
    assert locked != former and locked.name.endswith(" locked feet") and former.name in bpy.data.actions
    after = joints_of(body)
    assert slid_mm(after, stood) < 1.0
    upper = [joint for joint in range(INSIDE_HANDS) if joint not in (1, 2, 4, 5, 7, 8, 10, 11)]
    assert distance_mm(after[:, upper] - after[:, :1], before[:, upper] - before[:, :1]) < 0.1
    assert distance_mm(after, before) < 60.0


def test_a_clip_that_never_stands_has_no_feet_to_lock(mocap, scene, tmp_path: Path) -> None:
    clip = write_bvh(tmp_path / "clip.bvh", known_motion(load_body(), np.zeros(10), FRAMES))
    assert bpy.ops.mocap.import_motion(filepath=str(clip), scene_setup="TAKE") == {"FINISHED"}
    curves = action_curves(mocap.review.take)
    for point in next(c for c in curves if c.data_path == 'pose.bones["pelvis"].location').keyframe_points:
        point.co.y += 0.02 * point.co.x
    takes = len(bpy.data.actions)
    assert bpy.ops.mocap.lock_feet() == {"CANCELLED"}
    assert len(bpy.data.actions) == takes


def ball_stands(body: bpy.types.Object) -> list[tuple[int, int, int]]:
    """Return joint, first frame and end of each stretch in which a ball of the foot stands."""
    balls = joints_of(body)[:, list(BALLS)]
    way, seconds = steps(balls, FPS)
    runs = stands(balls[..., 2], np.linalg.norm(way, axis=-1) / seconds, FPS)
    return [(BALLS[side], *run) for side in range(2) for run in runs[side]]


def slid_mm(joints: np.ndarray, stretches: list[tuple[int, int, int]]) -> float:
    """Return how far a ball of the foot is at most from its mean place in a stretch."""
    held = [joints[first:stop, joint] for joint, first, stop in stretches]
    return max(distance_mm(points, points.mean(axis=0)) for points in held)
