"""Joints at rest are drawn apart, named by the panel and left out of tables."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blender_addon.animation.curves import current_action
from blender_addon.animation.lanes import resting_at, resting_bones
from blender_addon.conventions.skeleton import JOINTS
from blender_addon.export.take import take_of
from blender_addon.export.write import export_take
from blender_addon.review.ranges import RESTING, joint_weights, paint_bones, skin_colours
from blender_addon.scene.bake import BakedTake, BakeSettings, bake_take
from solver_backend.io.markers.read import read_markers

ALWAYS, AT_TIMES = ("left_wrist", "left_hand"), "head"
FROM = 12


@pytest.fixture
def partial(scene: Any, files: Any) -> BakedTake:
    motion = files.motion
    resting = np.zeros((motion.num_frames, 24), dtype=bool)
    resting[:, [JOINTS.index(name) for name in ALWAYS]] = True
    resting[FROM:, JOINTS.index(AT_TIMES)] = True
    sigma = np.full((motion.num_frames, 24), 0.01) if motion.joint_sigma is None else motion.joint_sigma
    resting_motion = replace(motion, resting=resting, joint_sigma=sigma)
    return bake_take(scene, resting_motion, files.body, files.capture, BakeSettings())


def test_lanes_hold_the_frames_at_rest(partial: BakedTake) -> None:
    first = current_action(partial.armature).frame_range[0]
    lanes = resting_at(current_action(partial.armature), first + np.array([0.0, FROM - 1, FROM, FROM + 3]))
    assert {name: lane.tolist() for name, lane in lanes.items()} == {
        **{name: [True] * 4 for name in ALWAYS}, AT_TIMES: [False, False, True, True],
    }  # fmt: skip
    assert resting_bones(partial.armature, first) == {*ALWAYS}


def test_bones_and_skin_at_rest_are_grey(partial: BakedTake) -> None:
    first = current_action(partial.armature).frame_range[0]
    paint_bones(partial.armature, first, shown=True)
    shades = {bone.name: np.array(bone.color.custom.normal) for bone in partial.armature.pose.bones}
    assert np.allclose(shades["left_wrist"], RESTING, atol=0.01)
    assert not np.allclose(shades["right_wrist"], RESTING, atol=0.1)
    weights = joint_weights(partial.mesh, JOINTS)
    found, wrist = skin_colours(weights, JOINTS, {}, {"left_wrist"}), JOINTS.index("left_wrist")
    assert np.allclose(found[weights[:, wrist] > 0.99], RESTING, atol=0.02)
    assert np.allclose(found[weights[:, wrist] == 0.0], skin_colours(weights, JOINTS, {})[weights[:, wrist] == 0.0])


def test_tables_leave_out_what_rests(scene: Any, partial: BakedTake, tmp_path: Path) -> None:
    for name in ("trc", "csv"):
        export_take(take_of(scene, partial.armature), name, tmp_path / f"walk.{name}")
    cloud = read_markers(tmp_path / "walk.trc").cloud
    assert cloud.labels == tuple(joint for joint in JOINTS if joint not in ALWAYS)
    seen = np.isfinite(cloud.positions).all(-1)
    head = cloud.labels.index(AT_TIMES)
    assert seen[:FROM, head].all() and not seen[FROM:, head].any() and np.delete(seen, head, axis=1).all()
    lines = (tmp_path / "walk.csv").read_text().splitlines()
    row = dict(zip(lines[0].split(","), lines[-1].split(","), strict=True))
    assert "left_wrist_x_m" not in row and row["head_x_m"] == "" and float(row["neck_x_m"]) < 100.0
