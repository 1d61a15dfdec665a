"""Clips that only Blender reads, onto our body: there and back, and what is missing."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest

from blender_addon._exchange.motion_file import MotionFile, read_motion
from blender_addon._exchange.so3 import matrix_from_rotvec, rotvec_from_matrix
from blender_addon.body.body_file import default_body_path, read_body
from blender_addon.headless.main import main
from blender_addon.retarget.motion.figures import actor_of_motion
from solver_backend.body.hands import by_finger, hand_skeletons, load_body_with_hands
from solver_backend.io.native.motion_file import write_motion
from tests.support.drawn_gloves import GLOVE_FPS, OFFSET_S, drawn_gloves, hands_bvh
from tests.support.played_character import FPS, FRAMES, known_clip, play_on_character, write_clip


@pytest.fixture
def played(scene: bpy.types.Scene) -> MotionFile:
    motion = known_clip()
    play_on_character(motion, scene)
    return motion


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".fbx", ".glb"])
def test_a_motion_goes_to_another_program_and_comes_back(played, tmp_path: Path, suffix: str, capfd: Any) -> None:
    clip, out = write_clip(tmp_path / f"walk{suffix}"), tmp_path / "back.npz"
    assert main(["motion convert", str(clip), "--out", str(out), "--keep-height", "--json"]) == 0
    result = json.loads(capfd.readouterr().out.splitlines()[-1])
    back = read_motion(out)
    assert result["frames"] == FRAMES and result["fps"] == pytest.approx(FPS, rel=1e-3)
    body = read_body(default_body_path())
    own, theirs = (actor_of_motion(motion, body) for motion in (played, back))
    # The two joints inside the hands are not SMPL's to turn.
    off = np.linalg.norm(own.joints - theirs.joints, axis=-1)[:, :22]
    assert off.max() < 0.002
    between = np.swapaxes(matrix_from_rotvec(played.rotvec), -1, -2) @ matrix_from_rotvec(back.rotvec)
    assert np.degrees(np.linalg.norm(rotvec_from_matrix(between), axis=-1))[:, :22].max() < 1.0


def test_what_is_missing_is_named(played, tmp_path: Path, capfd: Any) -> None:
    clip = write_clip(tmp_path / "walk.glb")
    for options, code in ((["--action", "run"], "actor_missing"), (["--armature", "x"], "actor_missing")):
        assert main(["motion convert", str(clip), "--out", str(tmp_path / "b.npz"), *options, "--json"]) == 3
        assert json.loads(capfd.readouterr().out.splitlines()[-1])["code"] == code
    assert main(["motion convert", str(tmp_path / "gone.fbx"), "--out", str(tmp_path / "b.npz"), "--json"]) == 3
    assert json.loads(capfd.readouterr().out.splitlines()[-1])["code"] == "file_missing"


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:Exception ignored in")  # Blender's BVH importer leaves its file open
def test_hands_of_an_fbx_are_added(scene: bpy.types.Scene, tmp_path: Path, capfd: Any) -> None:
    drawn = drawn_gloves()
    scene.render.fps = round(GLOVE_FPS)
    bvh = hands_bvh(tmp_path / "glove.bvh", drawn, 0, "LeftHand{finger}{number}")
    bpy.ops.import_anim.bvh(filepath=str(bvh), global_scale=0.01, update_scene_fps=True, update_scene_duration=True)
    clip = tmp_path / "glove.fbx"
    bpy.ops.export_scene.fbx(filepath=str(clip), object_types={"ARMATURE"}, bake_anim_simplify_factor=0.0)
    motion, out = write_motion(tmp_path / "m.npz", drawn.motion), tmp_path / "hands.npz"
    assert main(["hands add", str(motion), str(clip), "--out", str(out), "--json"]) == 0
    result = json.loads(capfd.readouterr().out.splitlines()[-1])
    assert result["gloves"][0]["sides"] == ["left"]
    # Blender's scene begins at frame 1, and its FBX exporter at the first frame of the action.
    assert result["gloves"][0]["offset_s"] == pytest.approx(OFFSET_S, abs=0.02)
    turns = matrix_from_rotvec(read_motion(out).rotvec[:, 22:37]).reshape(-1, 15, 3, 3)
    skeleton = hand_skeletons(load_body_with_hands())[0]
    off = np.rad2deg(np.abs(skeleton.angles_of(by_finger(turns)) - drawn.angles[:, 0]))[30:-5]
    assert np.sqrt((off**2).mean()) < 1.5
