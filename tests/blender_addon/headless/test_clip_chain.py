"""A clip of another program is edited like a solve of ours: brought in, baked with few keys, laid on a rig."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest

from blender_addon._exchange.motion_file import read_motion
from blender_addon.animation.deviation import evaluated_joints
from blender_addon.body.body_file import default_body_path, pose_joints, read_body
from blender_addon.headless.main import main
from solver_backend.body.body import load_body
from tests.support.bvh_texts import known_motion, write_bvh
from tests.support.retarget_measures import score
from tests.support.retarget_rigs import mixamo

FRAMES, FPS, WITHIN_MM = 60, 30.0, 8.0
BETAS = np.array([0.8, -0.5, 0.6, 0.0, 0.3, 0.0, 0.0, 0.0, 0.0, 0.0])


def result_of(verb: str, *arguments: object, capfd: Any) -> dict[str, Any]:
    assert main([verb, *map(str, arguments), "--json"]) == 0
    return json.loads(capfd.readouterr().out.splitlines()[-1])


@pytest.mark.slow
def test_a_foreign_clip_is_keyed_sparsely_and_laid_on_a_rig(scene: bpy.types.Scene, tmp_path: Path, capfd: Any) -> None:
    known = known_motion(load_body(), BETAS, FRAMES, FPS)
    names = tuple(f"mixamorig:{name}" for name in known.names)
    clip = write_bvh(tmp_path / "suit.bvh", replace(known, names=names), arms_down=0.8, unit=0.0254)
    motion = tmp_path / "suit.npz"
    brought = result_of("motion convert", clip, "--out", motion, "--keep-height", capfd=capfd)
    assert brought["frames"] == FRAMES and brought["problems"] == []

    baked = result_of("bake", motion, "--out", tmp_path, "--no-pictures", "--keys-within", WITHIN_MM, capfd=capfd)
    assert any("keys remain" in note for note in baked["notes"])
    blend = tmp_path / "suit.blend"
    bpy.ops.wm.open_mainfile(filepath=str(blend))
    read, body = read_motion(motion), read_body(default_body_path())
    armature = next(item for item in bpy.data.objects if item.type == "ARMATURE")
    shown = np.stack([evaluated_joints(bpy.context.scene, armature, frame) for frame in range(1, FRAMES + 1)])
    _, joints = pose_joints(body.rest_joints(read.betas), read.rotvec, read.transl)
    assert 1000.0 * np.linalg.norm(shown[:, :22] - joints[:, :22], axis=-1).max() <= WITHIN_MM + 0.1

    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    _, limbs = mixamo()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "rig.blend"))
    out = tmp_path / "played.blend"
    result_of("retarget", blend, "--target", tmp_path / "rig.blend", "--out", out, capfd=capfd)
    bpy.ops.wm.open_mainfile(filepath=str(out))
    rig = next(item for item in bpy.data.objects if item.type == "ARMATURE")
    times = np.array(rig.animation_data.action.frame_range)
    found = score(rig, limbs, read, body, np.linspace(*times, FRAMES))
    # Few keys leave joints within so many millimetres; hands, from the shoulders on, twice that.
    assert found.hands_mm < 2.0 * WITHIN_MM and found.steps_mm < 2.0 * WITHIN_MM
    assert found.feet_mm < 2.0 * WITHIN_MM + 33.0  # a lock moves a foot of this size by little more than 3 cm
    assert found.skating <= 1.2 * found.skating_actor
    assert found.path_ratio == pytest.approx(1.0, abs=0.03)  # hips follow feet that are locked while the clip glides
