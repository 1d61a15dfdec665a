"""Soles and size of rigs whose bone tails are made up, of odd units and axes, with a skin and without."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import pytest

from blender_addon.conventions.timing import TakeTiming
from blender_addon.errors import TargetUnsuitable
from blender_addon.retarget.motion.figures import actor_of_motion
from blender_addon.retarget.motion.transfer import TransferSettings
from blender_addon.retarget.retarget import Retargeted, RetargetSettings, retarget
from tests.support.addon_stand_in import Files
from tests.support.foreign_namings import NAMINGS
from tests.support.foreign_rigs import foreign_rig, limbs_of
from tests.support.foreign_skeletons import draw
from tests.support.retarget_measures import Limb, score, shown
from tests.support.retarget_rigs import map_of_rig

TIMING = TakeTiming(1, 30.0)


@pytest.fixture
def files(files: Files) -> Files:
    """The stand-in walk with elbows that a person can bend."""
    rotvec = files.motion.rotvec.copy()
    rotvec[:, (18, 19)] *= 0.2
    return replace(files, motion=replace(files.motion, rotvec=rotvec))


def play(rig: bpy.types.Object, files: Files, **how: float) -> Retargeted:
    actor = actor_of_motion(files.motion, files.body)
    settings = RetargetSettings(transfer=TransferSettings(**how))
    return retarget(actor, rig, bpy.context.scene, map_of_rig(rig), TIMING, settings)


def assert_right(rig: bpy.types.Object, limbs: dict[str, Limb], done: Retargeted, files: Files) -> None:
    times = TIMING.scene_frames(files.motion.num_frames, files.motion.fps)
    found = score(rig, limbs, files.motion, files.body, times)
    assert found.hands_mm < 5.0 and found.feet_mm < 10.0 and found.twist_deg < 5.0
    assert found.wrists_deg < 5.0 and found.hips_deg < 5.0 and found.pelvis_deg < 0.1
    assert found.path_ratio == pytest.approx(1.0, abs=0.01)
    assert done.deviation_mm < 5.0 and not done.notes


@pytest.mark.parametrize("tails", [0.2, 1.0, 100.0])
@pytest.mark.parametrize(("unit", "y_up", "sole"), [(1.0, False, 0.0), (0.01, True, None), (100.0, False, None)])
def test_tails_units_and_axes_do_not_matter(scene, files: Files, tails, unit, y_up, sole) -> None:
    rig, limbs = foreign_rig(draw(NAMINGS["unreal_4"], 45.0), unit=unit, tails=tails, y_up=y_up, sole=sole)
    done = play(rig, files)
    assert_right(rig, limbs, done, files)
    assert done.soles == ("joints" if sole is None else "mesh")


def test_a_mirrored_armature_plays_the_motion_unmirrored(scene, files: Files) -> None:
    rig, limbs = foreign_rig(draw(NAMINGS["mixamo"], 20.0))
    rig.scale = (-1.0, 1.0, 1.0)
    bpy.context.view_layer.update()
    other = {"left": "right", "right": "left"}
    seen = {f"{other[side]}_{limb}": limbs[f"{side}_{limb}"] for side in other for limb in ("arm", "leg")}
    assert_right(rig, seen, play(rig, files), files)


def test_the_lowest_skin_of_the_feet_is_the_floor_that_it_stands_on(scene, files: Files) -> None:
    skeleton, lowest = draw(NAMINGS["vroid"]), []
    frames = TIMING.scene_frames(files.motion.num_frames, files.motion.fps)
    for sole in (0.0, -0.06):
        rig, _ = foreign_rig(skeleton, sole=sole)
        done = play(rig, files)
        toes = [skeleton.roles[f"{side}_toe"] for side in ("left", "right")]
        lowest.append(min(heads[:, 2].min() for heads in shown(rig, toes, frames).heads.values()))
        assert done.soles == "mesh"
    assert lowest[1] == pytest.approx(lowest[0], abs=0.005)  # feet in thick soles stand where they stood


def test_a_skin_that_does_not_fit_the_skeleton_shows_no_soles(scene, files: Files) -> None:
    rig, limbs = foreign_rig(draw(NAMINGS["vroid"]), sole=0.0)
    bpy.data.objects["Shoes"].scale = (100.0, 100.0, 100.0)
    bpy.context.view_layer.update()
    done = play(rig, files)
    assert done.soles == "joints"
    assert_right(rig, limbs, done, files)


def test_legs_that_arms_and_trunk_contradict_are_refused_unless_the_scale_is_given(scene, files: Files) -> None:
    skeleton = draw(NAMINGS["unreal_4"])
    long = skeleton.placed(lambda p: p * [1, 1, 4] if p[2] < 0.93 else p + [0, 0, 3 * 0.92])
    rig, _ = foreign_rig(long)
    with pytest.raises(TargetUnsuitable, match=r"size is ambiguous\. .*legs 4\.\d+, arms 1\.\d+"):
        play(rig, files)
    assert not bpy.data.actions and rig.animation_data is None
    assert play(rig, files, scale=2.0).scale == 2.0


def test_hands_that_a_constraint_holds_elsewhere_are_refused(scene, files: Files) -> None:
    skeleton = draw(NAMINGS["unreal_4"])
    rig, _ = foreign_rig(skeleton)
    limit = rig.pose.bones["lowerarm_l"].constraints.new("LIMIT_LOCATION")
    limit.use_max_z, limit.max_z = True, 0.6
    with pytest.raises(TargetUnsuitable, match=r"would be up to [\d.]+ m "):
        play(rig, files)
    assert not bpy.data.actions


def test_a_character_from_gltf_keeps_its_size(files: Files, shared_data: Path) -> None:
    bpy.ops.wm.open_mainfile(filepath=str(shared_data / "cases/markers/bone_tails_as_soles/armature.blend"))
    rig = bpy.data.objects["Armature"]
    done = play(rig, files)
    assert_right(rig, limbs_of(done.rig_map.bones), done, files)
    assert np.abs(np.array([done.scale, done.proportions.arms]) - 1).max() < 0.15


@pytest.mark.parametrize("version", ["vrm0", "vrm1"])
def test_the_humanoid_of_a_vrm_is_read_from_its_armature(scene, files: Files, version: str) -> None:
    skeleton = draw(NAMINGS["vrm_own_names"])
    rig, limbs = foreign_rig(skeleton, tails=50.0, sole=0.0)
    words = {"pelvis": "hips", "head": "head", "spine_1": "spine", "spine_2": "chest", "neck_1": "neck"}
    parts = {"upper_arm": "UpperArm", "forearm": "LowerArm", "hand": "Hand", "thigh": "UpperLeg", "shin": "LowerLeg"}
    parts |= {"foot": "Foot", "toe": "Toes", "clavicle": "Shoulder"}
    words |= {f"{side}_{part}": side + word for side in ("left", "right") for part, word in parts.items()}
    named = {word: skeleton.roles[role] for role, word in words.items()}
    if version == "vrm1":
        bones = {human: {"node": {"bone_name": bone}} for human, bone in named.items()}
    else:
        bones = [{"bone": human, "node": {"bone_name": bone}} for human, bone in named.items()]
    rig.data["vrm_addon_extension"] = {version: {"humanoid": {"human_bones": bones}}}
    done = play(rig, files)
    assert done.rig_map.label == "VRM humanoid of the file"
    assert_right(rig, limbs, done, files)
