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
from blender_addon.conventions.timing import TakeTiming
from blender_addon.headless.main import main
from blender_addon.retarget.motion.figures import actor_of_motion
from blender_addon.retarget.recognition import map_rig
from blender_addon.retarget.retarget import retarget
from solver_backend.body.body import load_body
from solver_backend.synthesis.embedded.choreography import author_motion
from tests.support.foreign_characters import skinned_rig
from tests.support.own_skeleton import own_skeleton

BETAS = np.array([0.8, -0.5, 0.6, 0.9, 0.3, 0.0, 0.0, 0.0, 0.0, 0.0])
FRAMES, FPS = 60, 30.0


@pytest.fixture
def played(scene: bpy.types.Scene) -> MotionFile:
    """Lay a known motion on a character of the body's proportions, with a skin."""
    own = author_motion(load_body(), BETAS, FRAMES, FPS)
    pose = np.zeros((FRAMES, 24, 3))
    pose[:, 0], pose[:, 1:22] = own.global_orient, own.body_pose.reshape(FRAMES, -1, 3)[:, :21]
    motion = MotionFile("walk", pose, own.transl, BETAS, FPS)
    body = read_body(default_body_path())
    rig = skinned_rig(own_skeleton(body, BETAS))
    scene.render.fps, scene.frame_end = int(FPS), FRAMES
    retarget(actor_of_motion(motion, body), rig, scene, map_rig(rig), TakeTiming(1, FPS))
    return motion


def write_clip(path: Path) -> Path:
    if path.suffix == ".fbx":
        bpy.ops.export_scene.fbx(
            filepath=str(path), add_leaf_bones=False, bake_anim_use_all_actions=False, bake_anim_use_nla_strips=False,
            bake_anim_simplify_factor=0.0,
        )  # fmt: skip
    else:
        bpy.ops.export_scene.gltf(filepath=str(path), export_force_sampling=True, export_optimize_animation_size=False)
    return path


@pytest.mark.parametrize("suffix", [".fbx", ".glb"])
def test_a_motion_goes_to_another_program_and_comes_back(played, tmp_path: Path, suffix: str, capfd: Any) -> None:
    clip, out = write_clip(tmp_path / f"walk{suffix}"), tmp_path / "back.npz"
    assert main(["motion", str(clip), "--out", str(out), "--keep-height", "--json"]) == 0
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
        assert main(["motion", str(clip), "--out", str(tmp_path / "b.npz"), *options, "--json"]) == 3
        assert json.loads(capfd.readouterr().out.splitlines()[-1])["code"] == code
    assert main(["motion", str(tmp_path / "gone.fbx"), "--out", str(tmp_path / "b.npz"), "--json"]) == 3
    assert json.loads(capfd.readouterr().out.splitlines()[-1])["code"] == "file_missing"
