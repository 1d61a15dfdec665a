"""Rest poses that are no stance: bones along one axis, as in clips of LAFAN1 and Bandai-Namco, and leaning trunks."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import pytest

from blender_addon.body.body_file import default_body_path, read_body
from blender_addon.conventions.timing import TakeTiming
from blender_addon.retarget.motion.figures import actor_of_motion
from blender_addon.retarget.motion.transfer import TransferSettings
from blender_addon.retarget.recognition import map_rig, open_scene
from blender_addon.retarget.retarget import RetargetSettings, retarget
from blender_addon.retarget.rig_actor import _own_rest, chosen_actor, read_rig_actor
from blender_addon.retarget.target_rig import read_target
from solver_backend.body.body import load_body
from solver_backend.exchange.rigs.rest_frames import stage_axes
from solver_backend.exchange.so3 import matrix_from_rotvec, rotvec_from_matrix
from tests.support.bvh_texts import known_motion, write_bvh
from tests.support.foreign_namings import NAMINGS
from tests.support.foreign_rigs import foreign_rig
from tests.support.foreign_skeletons import ForeignSkeleton, draw
from tests.support.played_character import BETAS, FPS, FRAMES, known_clip
from tests.support.retarget_measures import score
from tests.support.standing_ankles import LOCKED_MM, STANDS_M, ankle_drifts_mm, cmu_actor

TIMES = TakeTiming(1, FPS).scene_frames(FRAMES, FPS)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # Blender's importer leaves files open.
@pytest.mark.parametrize("naming", ["ready_player_me", "unreal_4"])
def test_a_clip_whose_bones_point_along_one_axis_at_rest_is_played(tmp_path: Path, naming: str) -> None:
    known = known_motion(load_body(), BETAS, FRAMES, FPS)
    scene = open_scene(write_bvh(tmp_path / "clip.bvh", known, along_x=True))
    source = chosen_actor(scene, "", "clip.bvh")
    actor, timing, notes = read_rig_actor(source, scene, map_rig(source))
    assert any("not upright" in note and "upright pose of frame" in note for note in notes)
    rig, limbs = foreign_rig(draw(NAMINGS[naming], 30.0))
    retarget(actor, rig, bpy.context.scene, map_rig(rig), timing)
    found = score(rig, limbs, known_clip(), read_body(default_body_path()), TIMES)
    assert found.pelvis_deg < 3.0 and found.steps_mm < 10.0 and found.hands_mm < 60.0
    assert found.trunk_deg < 6.0 and found.head_deg < 10.0


def test_sides_in_one_place_at_rest_are_not_made_up() -> None:
    places = {"pelvis": np.zeros(3), "head": np.array([0.0, 0.0, 0.6])}
    for side in ("left", "right"):
        places |= {f"{side}_thigh": np.zeros(3), f"{side}_foot": np.array([0.0, 0.0, -0.9])}
    assert stage_axes(places) is None
    places["left_thigh"] = np.array([0.1, 0.0, 0.0])
    assert stage_axes(places) == pytest.approx(np.eye(3))


def leaning(skeleton: ForeignSkeleton, deg: float) -> ForeignSkeleton:
    """Return a skeleton with all above the hips turned forward about them."""
    hips = skeleton.heads[skeleton.roles["left_thigh"]] * [0.0, 1.0, 1.0]
    R = matrix_from_rotvec(np.array([np.radians(deg), 0.0, 0.0]))
    legs = {skeleton.roles[f"{side}_{part}"] for side in ("left", "right") for part in ("thigh", "shin", "foot", "toe")}
    moved = {b: h if b in legs or h[2] < hips[2] else hips + R @ (h - hips) for b, h in skeleton.heads.items()}
    return ForeignSkeleton(moved, skeleton.parents, skeleton.roles)


@pytest.mark.parametrize("deg", [0.0, 46.0])
def test_a_trunk_that_leans_at_rest_is_turned_upright(scene: bpy.types.Scene, deg: float) -> None:
    rig, limbs = foreign_rig(leaning(draw(NAMINGS["mixamo"]), deg))
    motion, body = known_clip(), read_body(default_body_path())
    exact = RetargetSettings(transfer=TransferSettings(hold_contacts=False))  # feet glide as in the clip
    done = retarget(actor_of_motion(motion, body), rig, scene, map_rig(rig), TakeTiming(1, FPS), exact)
    assert any("leans 4" in note for note in done.notes) == bool(deg)
    found = score(rig, limbs, motion, body, TIMES)
    assert found.feet_mm < 12.0 and found.hands_mm < 8.0
    assert found.trunk_deg < 8.0 and found.head_deg < 8.0


def holding(skeleton: ForeignSkeleton, deg: float) -> ForeignSkeleton:
    """Return a skeleton with its forearms turned forward about the elbows at rest."""
    heads = dict(skeleton.heads)
    for side, sign in (("left", -1.0), ("right", 1.0)):
        elbow, R = skeleton.roles[f"{side}_forearm"], matrix_from_rotvec(np.array([0.0, 0.0, sign * np.radians(deg)]))
        below = {elbow}
        while more := {bone for bone, above in skeleton.parents.items() if above in below} - below:
            below |= more
        heads |= {bone: heads[elbow] + R @ (heads[bone] - heads[elbow]) for bone in below}
    return ForeignSkeleton(heads, skeleton.parents, skeleton.roles)


def test_a_stance_with_bent_elbows_stays_the_rest_pose(scene: bpy.types.Scene) -> None:
    """The head is turned in all frames, so that no frame shows where it looks at rest."""
    rig, _ = foreign_rig(holding(draw(NAMINGS["mixamo"], 30.0), 60.0), sole=0.0)
    pose = known_clip().rotvec.copy()
    pose[:, 15] = [0.0, np.radians(40.0), 0.0]
    own = actor_of_motion(replace(known_clip(), rotvec=pose), read_body(default_body_path()))
    scene.render.fps = int(FPS)
    retarget(own, rig, scene, map_rig(rig), TakeTiming(1, FPS))
    read, _, notes = read_rig_actor(rig, scene, map_rig(rig))
    assert any("forearm is bent by" in note for note in notes) and not any("not upright" in note for note in notes)
    off = rotvec_from_matrix(own.turns[:, 15].swapaxes(-1, -2) @ read.turns[:, 15])
    assert np.degrees(np.linalg.norm(off, axis=-1)).max() < 1.0


@pytest.mark.parametrize("naming", ["ready_player_me", "unreal_4"])
def test_standing_ankles_of_a_recording_are_locked(scene: bpy.types.Scene, naming: str, shared_data: Path) -> None:
    rig, _ = foreign_rig(draw(NAMINGS[naming], 30.0))
    target = read_target(rig, scene, map_rig(rig), "fk").target
    takes = (cmu_actor(shared_data / "motion_cmu" / "mb2" / f"{take}.npz", _own_rest()) for take in ("02_01", "16_22"))
    drifts = np.concatenate([ankle_drifts_mm(actor, target) for actor in takes])
    stood = drifts[drifts[:, 0] < 1000.0 * STANDS_M]
    assert len(stood) >= 4 and np.median(stood[:, 0]) > LOCKED_MM
    assert stood[:, 1].max() < LOCKED_MM
