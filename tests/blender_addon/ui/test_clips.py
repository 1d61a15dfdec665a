"""The clip room: every button adds a take with a file of its own, and keeps the take and its edits."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import pytest

from blender_addon._exchange.clips import turn_covariance
from blender_addon._exchange.motion_file import read_motion, write_motion
from blender_addon.animation.curves import action_curves
from blender_addon.animation.deviation import evaluated_joints
from blender_addon.animation.takes import take_file
from blender_addon.scene.clips import played_motion


def _joints(action: bpy.types.Action, frames: list[int]) -> np.ndarray:
    armature = bpy.context.scene.mocap.review.armature
    return np.stack([evaluated_joints(bpy.context.scene, armature, frame) for frame in frames])


def _made(former: bpy.types.Action) -> bpy.types.Action:
    """Return the new take, which is played, listed and has a file of its own."""
    review = bpy.context.scene.mocap.review
    take = review.take
    assert take != former and take["clip_of"] == former.name and former.name in bpy.data.actions
    path = take_file(take, "motion_file")
    assert path.is_file() and path != take_file(former, "motion_file")
    assert read_motion(path).num_frames == take["frames"]
    from blender_addon.ui.operators.takes import takes_of_person

    assert {take, former} <= set(takes_of_person(bpy.context.scene.mocap))
    return take


def test_the_played_motion_is_the_solved_one(solved_take, mocap) -> None:
    motion, solved = (
        played_motion(bpy.context.scene, mocap.review.armature, solved_take),
        read_motion(take_file(solved_take, "motion_file"), whole=True),
    )
    count = solved.body_layout.num_joints
    assert np.abs(motion.joints[:, :22] - solved.joints[:, :22]).max() < 1e-5 and count in (24, 52)
    assert motion.joint_covariance is not None and np.array_equal(motion.contacts, solved.contacts)


def test_a_trimmed_take_keeps_its_poses_and_hand_edits(solved_take, mocap) -> None:
    armature = mocap.review.armature
    bpy.context.scene.frame_set(5)
    bone = armature.pose.bones["left_elbow"]
    bone.rotation_quaternion = (0.8, 0.6, 0.0, 0.0)
    bone.keyframe_insert("rotation_quaternion", frame=5)
    before = _joints(solved_take, [3, 5, 7])
    assert bpy.ops.mocap.trim_take(first=3, last=8) == {"FINISHED"}
    made = _made(solved_take)
    assert made["frames"] == 6
    assert np.abs(_joints(made, [1, 3, 5]) - before).max() < 1e-4
    assert not bpy.ops.mocap.resolve_range.poll()
    mocap.review.armature.animation_data.action = solved_take
    assert np.abs(_joints(solved_take, [3, 5, 7]) - before).max() < 1e-6


def test_mirrored_twice_is_the_take(solved_take, mocap) -> None:
    before = _joints(solved_take, [1, 6])
    assert bpy.ops.mocap.mirror_take() == {"FINISHED"}
    once = _made(solved_take)
    flipped = _joints(once, [1, 6])
    assert np.abs(flipped - before).max() > 0.02
    assert bpy.ops.mocap.mirror_take() == {"FINISHED"}
    assert np.abs(_joints(_made(once), [1, 6]) - before).max() < 1e-5


def test_the_root_control_carries_the_travel(solved_take, mocap) -> None:
    frames = [1, 4, 8]
    before = _joints(solved_take, frames)
    assert bpy.ops.mocap.root_take() == {"FINISHED"}
    made = _made(solved_take)
    assert np.abs(_joints(made, frames) - before).max() < 1e-4
    assert any('"root"' in curve.data_path and "location" in curve.data_path for curve in action_curves(made))
    # An edit of this clip starts from where the root carries it.
    assert bpy.ops.mocap.retime_take(speed=0.5) == {"FINISHED"}
    slow = _made(made)
    assert np.abs(_joints(slow, [2 * frame - 1 for frame in frames]) - before).max() < 1e-4
    assert read_motion(take_file(slow, "motion_file")).root is not None
    # The solved take is where it was, without the root's travel.
    assert bpy.ops.mocap.show_take(name=solved_take.name) == {"FINISHED"}
    assert np.abs(_joints(solved_take, frames) - before).max() < 1e-6


@pytest.mark.parametrize("name", ["retime_take", "root_take"])
def test_a_clip_stays_where_the_user_put_the_body(name, solved_take, mocap) -> None:
    root = mocap.review.armature.pose.bones["root"]
    root.location = (0.0, 2.0, 0.5)  # not keyed
    root.rotation_mode, root.rotation_quaternion = "QUATERNION", (0.8, 0.0, 0.6, 0.0)
    before = _joints(solved_take, [1, 4])
    assert getattr(bpy.ops.mocap, name)() == {"FINISHED"}
    made = _made(solved_take)
    assert np.abs(_joints(made, [1, 4]) - before).max() < 1e-4
    for take in (solved_take, made):
        assert bpy.ops.mocap.show_take(name=take.name) == {"FINISHED"}
        assert np.abs(_joints(take, [1, 4]) - before).max() < 1e-4


def test_an_edited_body_is_not_where_markers_saw_it(solved_take, mocap) -> None:
    armature = mocap.review.armature
    path = take_file(solved_take, "motion_file")
    motion = read_motion(path, whole=True)
    seen = motion.joints[:, :5].copy()
    write_motion(path, replace(motion, markers=seen, marker_labels=tuple("abcde")), overwrite=True)
    assert played_motion(bpy.context.scene, armature, solved_take).markers is not None
    root = armature.pose.bones["root"]
    root.rotation_mode, root.rotation_quaternion = "QUATERNION", (0.0, 0.0, 0.0, 1.0)
    root.keyframe_insert("rotation_quaternion", frame=1)
    turned = played_motion(bpy.context.scene, armature, solved_take)
    assert turned.markers is None
    half = np.diag([-1.0, -1.0, 1.0])
    assert np.allclose(turned.joint_covariance, turn_covariance(motion.joint_covariance, half), atol=1e-9)


def test_a_layer_is_not_left_behind(solved_take, mocap) -> None:
    assert bpy.ops.mocap.edit_on_layer() == {"FINISHED"}
    for name in ("trim", "loop", "mirror", "retime", "resample", "place", "root"):
        assert not getattr(bpy.ops.mocap, f"{name}_take").poll(), name
    assert not bpy.ops.mocap.join_takes.poll()
    with pytest.raises(RuntimeError, match="A layer plays on top of this take"):
        bpy.ops.mocap.mirror_take()
    animation = mocap.review.armature.animation_data
    animation.action = None
    assert bpy.ops.mocap.mirror_take() == {"FINISHED"}


def test_a_range_outside_the_take_is_refused(solved_take, mocap) -> None:
    with pytest.raises(RuntimeError, match=r"no frames 500 to 600.*plays from frame 1 to"):
        bpy.ops.mocap.trim_take(first=500, last=600)


def test_the_copy_of_a_clip_is_no_solved_take(solved_take, mocap) -> None:
    assert bpy.ops.mocap.mirror_take() == {"FINISHED"}
    assert bpy.ops.mocap.thin_take() == {"FINISHED"}
    assert mocap.review.take["clip_of"] == solved_take.name and not bpy.ops.mocap.resolve_range.poll()
    assert bpy.ops.mocap.lock_feet.poll()


@pytest.mark.parametrize(("name", "options"), [("resample_take", {"fps": 60.0}), ("place_take", {})])
def test_a_button_adds_a_take(name, options, solved_take, mocap) -> None:
    assert getattr(bpy.ops.mocap, name)(**options) == {"FINISHED"}
    made = _made(solved_take)
    assert made.use_fake_user and solved_take.use_fake_user
    # It plays from an NLA strip with its slot like any action.
    before = _joints(made, [2, 5])
    assert bpy.ops.mocap.push_down() == {"FINISHED"}
    strip = mocap.review.armature.animation_data.nla_tracks[-1].strips[0]
    assert strip.action == made and (not hasattr(strip, "action_slot") or strip.action_slot == made.slots[0])
    assert np.abs(_joints(made, [2, 5]) - before).max() < 1e-6


def test_takes_are_joined(solved_take, mocap) -> None:
    assert bpy.ops.mocap.mirror_take() == {"FINISHED"}
    mirrored = mocap.review.take
    assert bpy.ops.mocap.join_takes(name=solved_take.name) == {"FINISHED"}
    made = _made(mirrored)
    assert made["frames"] == 2 * solved_take["frames"] - 1
    with pytest.raises(RuntimeError, match="no take 'nothing' for this person"):
        bpy.ops.mocap.join_takes(name="nothing")


def test_a_take_without_a_cycle_says_so(solved_take, mocap) -> None:
    folder = Path(take_file(solved_take, "motion_file")).parent
    before = sorted(folder.iterdir())
    with pytest.raises(RuntimeError, match="does not repeat|no cycle"):
        bpy.ops.mocap.loop_take()
    assert mocap.review.take == solved_take and sorted(folder.iterdir()) == before


@pytest.mark.slow  # two pictures, rendered without a graphics card
def test_takes_and_poses_are_assets_with_a_picture(solved_take, mocap, tmp_path) -> None:
    armature = mocap.review.armature
    assert bpy.ops.mocap.mark_take() == {"FINISHED"} and solved_take.asset_data is not None
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "assets.blend"))
    bone = armature.pose.bones["right_elbow"]
    bone.rotation_quaternion = (0.8, 0.0, 0.6, 0.0)  # not keyed
    assert bpy.ops.mocap.mark_pose() == {"FINISHED"}
    [pose] = [action for action in bpy.data.actions if action.name.endswith(" pose")]
    written = {(c.data_path, c.array_index): c.evaluate(0) for c in action_curves(pose)}
    path = 'pose.bones["right_elbow"].rotation_quaternion'
    assert np.allclose([written[path, k] for k in range(4)], (0.8, 0.0, 0.6, 0.0), atol=1e-5)
    catalogs = (tmp_path / "blender_assets.cats.txt").read_text(encoding="utf-8")
    assert f"{pose.asset_data.catalog_id}:Poses/Manifold MoCap" in catalogs
    for action in (solved_take, pose):
        pixels = np.array(action.preview.image_pixels_float).reshape(256, 256, 4)
        assert np.ptp(pixels[..., :3], axis=(0, 1)).min() > 0.2  # a body in front of a background
    assert armature.animation_data.action == solved_take
