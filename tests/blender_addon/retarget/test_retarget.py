"""Motions on rigs in Blender: hands, feet and twist measured from what the rigs show."""

from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np
import pytest

from blender_addon.animation.curves import action_curves
from blender_addon.body.body_file import pose_joints
from blender_addon.conventions.timing import TakeTiming
from blender_addon.errors import MapInvalid, TargetUnsuitable
from blender_addon.retarget.motion.figures import actor_of_motion
from blender_addon.retarget.motion.transfer import TransferSettings
from blender_addon.retarget.recognition import named_preset
from blender_addon.retarget.retarget import MAP, RetargetSettings, retarget
from blender_addon.retarget.rig_actor import read_actor
from blender_addon.scene.bake import BakeSettings, bake_take
from tests.support.addon_stand_in import Files
from tests.support.mixamo_rig import PREFIX, mixamo_rig
from tests.support.retarget_measures import score, shown
from tests.support.retarget_rigs import map_of_rig, mixamo, mixamo_limbs, rigify

TIMING = TakeTiming(1, 30.0)
ELBOWS = (18, 19)


@pytest.fixture
def files(files: Files) -> Files:
    """The stand-in walk with elbows that a person can bend: no arm of other proportions folds up as far."""
    rotvec = files.motion.rotvec.copy()
    rotvec[:, ELBOWS] *= 0.2
    return replace(files, motion=replace(files.motion, rotvec=rotvec))


def play(rig, files: Files, limbs: str = "fk", rig_map=None, **how: bool):
    """Retarget the stand-in walk."""
    actor = actor_of_motion(files.motion, files.body)
    settings = RetargetSettings(limbs, TransferSettings(**how))
    return retarget(actor, rig, bpy.context.scene, rig_map or map_of_rig(rig), TIMING, settings)


def times(files: Files) -> np.ndarray:
    return TIMING.scene_frames(files.motion.num_frames, files.motion.fps)


@pytest.mark.parametrize(("build", "arms_down"), [("short", 0.0), ("tall", 0.0), ("tall", 45.0)])
def test_hands_feet_and_twist_come_out_right_on_a_mixamo_rig(scene, files: Files, build, arms_down) -> None:
    rig, limbs = mixamo(build, arms_down_deg=arms_down)
    done = play(rig, files)
    found = score(rig, limbs, files.motion, files.body, times(files))
    assert found.hands_mm < 1.0 and found.feet_mm < 1.0 and found.twist_deg < 5.0
    assert found.wrists_deg < 5.0 and found.hips_deg < 5.0 and found.pelvis_deg < 0.1
    assert done.deviation_mm < 1.0 and done.rig_map.label == "Mixamo" and not done.notes


def test_twisted_wrists_and_thighs_are_seen_by_the_measures(scene, files: Files) -> None:
    rig, limbs = mixamo("short")
    done = play(rig, files)
    before = score(rig, limbs, files.motion, files.body, times(files))
    twisted = bpy.data.objects.new("Twisted", None)
    bpy.context.scene.collection.objects.link(twisted)
    twisted.rotation_euler = (0.0, 0.35, 0.0)  # about the bone itself
    for name in ("RightHand", "LeftUpLeg"):
        turn = rig.pose.bones[f"{PREFIX}{name}"].constraints.new("COPY_ROTATION")
        turn.target, turn.owner_space, turn.mix_mode = twisted, "LOCAL", "AFTER"
    after = score(rig, limbs, files.motion, files.body, times(files))
    assert done.action is not None and max(before.wrists_deg, before.hips_deg) < 5.0
    assert after.wrists_deg > 15.0 and after.hips_deg > 15.0


def test_the_axes_of_the_bones_do_not_matter(scene, files: Files) -> None:
    rng = np.random.default_rng(0)
    plain = mixamo_rig("Plain")
    names = [bone.name for bone in plain.data.bones]
    rolled = mixamo_rig(
        "Rolled", rolls={name.removeprefix(PREFIX): float(rng.uniform(-np.pi, np.pi)) for name in names}
    )
    seen = []
    for rig in (plain, rolled):
        play(rig, files)
        seen.append(shown(rig, names, times(files)[::10]))
    for name in names:
        assert np.abs(seen[0].heads[name] - seen[1].heads[name]).max() < 1e-4
        assert np.abs(seen[0].turns[name] - seen[1].turns[name]).max() < 1e-3


@pytest.mark.parametrize("limbs", ["fk", "ik"])
def test_a_generated_rigify_rig_plays_it_by_either_controls(scene, files: Files, limbs: str) -> None:
    rig, shown_by = rigify()
    done = play(rig, files, limbs)
    found = score(rig, shown_by, files.motion, files.body, times(files))
    assert found.hands_mm < 5.0 and found.feet_mm < 5.0 and done.deviation_mm < 5.0
    assert limbs == "ik" or found.twist_deg < 5.0
    assert done.rig_map.label == "Rigify" and not done.notes
    keyed = {curve.data_path for curve in action_curves(done.action)}
    assert 'pose.bones["foot_ik.L"].location' in keyed and 'pose.bones["shin_fk.R"].rotation_quaternion' in keyed


def test_nothing_of_the_users_is_lost(scene, files: Files) -> None:
    rig, _ = mixamo()
    bone = rig.pose.bones[f"{PREFIX}Head"]
    bone.rotation_mode = "XYZ"
    bone.rotation_euler = (0.1, 0.2, 0.3)
    finger = rig.pose.bones[f"{PREFIX}LeftHandMiddle1"]
    finger.rotation_quaternion = (0.8, 0.6, 0.0, 0.0)
    bone.keyframe_insert("rotation_euler", frame=3)
    before = rig.animation_data.action
    keys = [tuple(k.co) for c in action_curves(before) for k in c.keyframe_points]
    matrix, objects = rig.matrix_world.copy(), set(bpy.data.objects)
    done = play(rig, files)
    assert rig.animation_data.action == done.action != before
    [track] = rig.animation_data.nla_tracks
    assert track.mute and track.strips[0].action == before
    assert keys == [tuple(k.co) for c in action_curves(before) for k in c.keyframe_points]
    assert tuple(finger.rotation_quaternion) == pytest.approx((0.8, 0.6, 0.0, 0.0))
    assert rig.matrix_world == matrix and set(bpy.data.objects) == objects and len(bpy.data.scenes) == 1
    assert 'pose.bones["mixamorig:Head"].rotation_euler' in {c.data_path for c in action_curves(done.action)}


def test_a_map_pose_that_was_kept_gives_the_same_motion(scene, files: Files) -> None:
    names = [bone for limb in mixamo_limbs().values() for bone in limb.bones]
    rig, _ = mixamo(arms_down_deg=30.0)
    done = play(rig, files)
    first = shown(rig, names, times(files)[::10])
    again = play(rig, files, rig_map=done.rig_map)
    second = shown(rig, names, times(files)[::10])
    assert MAP in again.action and done.rig_map.map_pose
    assert max(np.abs(first.turns[name] - second.turns[name]).max() for name in names) < 1e-4
    turned = replace(done.rig_map, map_pose={f"{PREFIX}LeftHand": (0.0, 1.0, 0.0, 0.0)})
    play(rig, files, rig_map=turned)
    third = shown(rig, names, times(files)[::10])
    assert np.abs(first.turns[f"{PREFIX}LeftHand"] - third.turns[f"{PREFIX}LeftHand"]).max() > 1.0


def test_a_moved_turned_and_scaled_object_carries_the_motion_along(scene, files: Files) -> None:
    rig, _ = mixamo()
    names = [f"{PREFIX}LeftHand", f"{PREFIX}RightFoot"]
    play(rig, files)
    before, world = shown(rig, names, times(files)[::10]), np.array(rig.matrix_world)
    rig.location, rig.rotation_euler.z, rig.scale = (2.0, -1.0, 0.5), 1.2, (0.02, 0.02, 0.02)
    bpy.context.view_layer.update()
    play(rig, files)
    after, moved = shown(rig, names, times(files)[::10]), np.array(rig.matrix_world)
    carry = moved @ np.linalg.inv(world)
    for name in names:
        assert np.abs(before.heads[name] @ carry[:3, :3].T + carry[:3, 3] - after.heads[name]).max() < 1e-3


@pytest.mark.slow
def test_in_place_stays_and_a_root_bone_carries_the_way(scene, files: Files) -> None:
    rig, _ = rigify()
    names = ["root", "ORG-spine", "ORG-foot.L"]
    play(rig, files)
    free = shown(rig, names, times(files))
    play(rig, files, in_place=True)
    still = shown(rig, names, times(files))
    assert np.ptp(free.heads["ORG-spine"][:, :2], axis=0).max() > 0.5
    assert np.linalg.norm(still.heads["ORG-spine"][:, :2], axis=1).max() < 0.3
    play(rig, files, root_motion=True)
    rooted = shown(rig, names, times(files))
    assert np.abs(rooted.heads["ORG-foot.L"] - free.heads["ORG-foot.L"]).max() < 2e-3
    assert np.linalg.norm((rooted.heads["root"] - free.heads["ORG-spine"])[:, :2], axis=1).max() < 0.3


def test_an_actor_in_blender_is_the_actor_of_its_file(scene, files: Files) -> None:
    take = bake_take(scene, files.motion, files.body, settings=BakeSettings(floor=False))
    of_file = actor_of_motion(files.motion, files.body)
    of_scene, timing = read_actor(take.armature, bpy.context.scene)
    assert timing.start == 1 and of_scene.fps == files.motion.fps
    assert np.abs(np.ptp([of_file.rest - of_scene.rest], axis=1)).max() < 1e-4
    assert np.abs(of_file.rest - of_scene.rest)[:, 2].max() < 1e-4
    assert np.abs(of_file.joints - of_scene.joints).max() < 1e-4
    assert np.abs(of_file.turns - of_scene.turns).max() < 1e-4


def test_half_a_rig_plays_what_it_has(scene, files: Files) -> None:
    rig, _ = mixamo(leave_out=("LeftArm", "RightArm", "Neck"))
    done = play(rig, files, rig_map=named_preset("mixamo", rig.data.bones.keys()))
    assert "no bones for head, left_upper_arm" in " ".join(done.notes) and done.deviation_mm < 1.0


def test_arms_without_hands_point_where_the_bodys_do(scene, files: Files) -> None:
    """At rest they hang by 50 degrees, by which they were off throughout."""
    rig, _ = mixamo("tall", arms_down_deg=50.0, leave_out=("LeftHand", "RightHand"))
    done = play(rig, files, rig_map=named_preset("mixamo", rig.data.bones.keys()))
    assert "no bones for left_hand, right_hand" in " ".join(done.notes)
    rest = files.body.rest_joints(files.motion.betas)
    _, joints = pose_joints(rest, files.motion.rotvec, files.motion.transl)
    for side, shoulder, elbow in (("Left", 16, 18), ("Right", 17, 19)):
        names = [f"{PREFIX}{side}{part}" for part in ("Arm", "ForeArm")]
        heads = shown(rig, names, times(files)).heads
        ways, own = heads[names[1]] - heads[names[0]], joints[:, elbow] - joints[:, shoulder]
        cosine = (ways * own).sum(-1) / np.linalg.norm(ways, axis=-1) / np.linalg.norm(own, axis=-1)
        assert np.degrees(np.arccos(cosine.min())) < 3.0


def test_too_little_of_a_rig_is_refused_and_left_alone(scene, files: Files) -> None:
    rig, _ = mixamo(leave_out=("LeftLeg", "RightLeg", "LeftForeArm", "RightForeArm"))
    with pytest.raises(MapInvalid, match=r"no bones for .*left_forearm"):
        play(rig, files)
    assert rig.animation_data is None and not bpy.data.actions


def test_a_stretched_armature_is_refused(scene, files: Files) -> None:
    rig, _ = mixamo()
    rig.scale = (0.01, 0.02, 0.01)
    bpy.context.view_layer.update()
    with pytest.raises(TargetUnsuitable, match="stretched"):
        play(rig, files)


def test_locked_channels_are_named(scene, files: Files) -> None:
    rig, _ = mixamo()
    rig.pose.bones[f"{PREFIX}LeftHand"].lock_rotation = (True, True, True)
    assert f"Locked and not animated: {PREFIX}LeftHand" in " ".join(play(rig, files).notes)
    rig.pose.bones[f"{PREFIX}LeftLeg"].lock_rotation = (True, False, False)
    actions = len(bpy.data.actions)
    with pytest.raises(TargetUnsuitable, match=r"Locked channels stop mixamorig:LeftLeg"):
        play(rig, files)
    assert len(bpy.data.actions) == actions


def test_constraints_that_wait_for_each_other_are_named(scene, files: Files) -> None:
    rig, _ = mixamo()
    for one, other in (("LeftHand", "RightHand"), ("RightHand", "LeftHand")):
        constraint = rig.pose.bones[PREFIX + one].constraints.new("COPY_ROTATION")
        constraint.target, constraint.subtarget = rig, PREFIX + other
    with pytest.raises(TargetUnsuitable, match=r"The bones .*LeftHand.* depend on each other"):
        play(rig, files)
    assert not bpy.data.actions


def test_a_bone_that_a_constraint_holds_is_named(scene, files: Files) -> None:
    rig, _ = mixamo()
    holder = bpy.data.objects.new("Holder", None)
    scene.collection.objects.link(holder)
    rig.pose.bones[f"{PREFIX}LeftArm"].constraints.new("COPY_ROTATION").target = holder
    with pytest.raises(TargetUnsuitable, match=r"prevent mixamorig:LeftArm from turning"):
        play(rig, files)
    assert not bpy.data.actions and len(bpy.data.scenes) == 1


def test_a_bone_that_a_driver_holds_is_named(scene, files: Files) -> None:
    rig, _ = mixamo()
    bone = rig.pose.bones[f"{PREFIX}LeftArm"]
    bone.rotation_mode = "QUATERNION"
    for index, value in enumerate(("1.0", "0.0", "0.0", "0.0")):
        bone.driver_add("rotation_quaternion", index).driver.expression = value
    with pytest.raises(TargetUnsuitable, match=r"drivers prevent mixamorig:LeftArm from turning"):
        play(rig, files)
    assert not bpy.data.actions and len(bpy.data.scenes) == 1


def test_a_wrong_or_doubled_name_in_a_map_is_named(scene, files: Files) -> None:
    rig, _ = mixamo()
    good = map_of_rig(rig)
    with pytest.raises(MapInvalid, match=r"no bones Hups \(pelvis\)"):
        play(rig, files, rig_map=replace(good, bones={**good.bones, "pelvis": "Hups"}))
    with pytest.raises(MapInvalid, match="has two roles"):
        play(rig, files, rig_map=replace(good, bones={**good.bones, "head": good.bones["pelvis"]}))
