"""Fingers in the panel: those of gloves onto a take by a button, and a range solved again with its fingers."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
import pytest

from blender_addon._exchange.motion_file import read_motion
from blender_addon.animation.deviation import evaluated_joints
from blender_addon.animation.takes import SolveFiles, take_file
from blender_addon.body.controls.limbs import finger_control, has_finger_controls
from blender_addon.conventions.file_paths import file_of
from blender_addon.ui.operators.import_results import take_motion
from solver_backend.fitters.pipeline import solve
from solver_backend.io.native.capture_file import write_capture
from solver_backend.io.native.motion_file import write_motion
from tests.support.drawn_gloves import OFFSET_S, drawn_gloves, hands_bvh, manus_csv
from tests.support.handed_take import handed_take
from tests.support.narrow_layout import draw_panel
from tests.support.short_solves import QUICK

FIRST_FINGER = 21  # Among the joints after the root.


@pytest.fixture(scope="module")
def drawn():
    return drawn_gloves()


@pytest.fixture
def plain(mocap, drawn, tmp_path: Path) -> bpy.types.Action:
    """A take without fingers."""
    bpy.ops.mocap.import_motion(filepath=str(write_motion(tmp_path / "walk.npz", drawn.motion)), scene_setup="TAKE")
    return mocap.review.take


@pytest.mark.slow
def test_gloves_give_a_take_its_fingers(mocap, plain, drawn, tmp_path: Path) -> None:
    assert bpy.types.VIEW3D_PT_mocap_fingers.poll(bpy.context) and not has_finger_controls(mocap.review.armature)
    assert "Add Gloves" in draw_panel(bpy.types.VIEW3D_PT_mocap_fingers, 283).drawn
    names = [hands_bvh(tmp_path / "Left.bvh", drawn, 0, "LeftHand{finger}{number}").name,
             manus_csv(tmp_path / "glove_right.csv", drawn, 1).name]  # fmt: skip
    chosen = [{"name": name} for name in names]
    assert bpy.ops.mocap.add_gloves(directory=str(tmp_path), files=chosen, states_offset=True, offset=OFFSET_S) == {
        "FINISHED"
    }
    take = mocap.review.take
    assert take != plain and plain.name in bpy.data.actions, "the former take stays"
    assert has_finger_controls(mocap.review.armature)
    before, after = (read_motion(take_file(action, "motion_file")) for action in (plain, take))
    assert after.rotvec.shape[1] == 52 and after.num_frames == before.num_frames
    np.testing.assert_allclose(after.rotvec[:, : FIRST_FINGER + 1], before.rotvec[:, : FIRST_FINGER + 1], atol=1e-6)
    assert np.abs(after.rotvec[30:, FIRST_FINGER + 1 :]).max(axis=(0, 2)).min() > 0.01, "every finger moves"


def test_what_is_wrong_with_a_recording_is_reported_and_changes_nothing(mocap, plain, tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match=r"does not exist.*none\.csv"):
        bpy.ops.mocap.add_gloves(filepath=str(tmp_path / "none.csv"))
    (tmp_path / "table.csv").write_text("a,b\n1,2\n")
    with pytest.raises(RuntimeError, match=r"table\.csv"):
        bpy.ops.mocap.add_gloves(filepath=str(tmp_path / "table.csv"))
    assert mocap.review.take == plain


@pytest.mark.slow
def test_a_range_keeps_a_curled_finger_and_solves_the_others(mocap, tmp_path: Path) -> None:
    """The solver's part is tests/fitters/hands/test_hand_range.py; this is the panel's."""
    source, scene = write_capture(tmp_path / "source.npz", handed_take(30, seed=2).capture), bpy.context.scene
    motion = write_motion(tmp_path / "take_01.npz", solve(handed_take(30, seed=2).capture, QUICK).motion)
    assert bpy.ops.mocap.import_capture(filepath=str(source)) == {"FINISHED"}
    take_motion(bpy.context, SolveFiles(motion, file_of(mocap.capture.file), None, None))
    review = mocap.review
    scene.frame_set(15)
    bone = review.armature.pose.bones[finger_control("left", "index")]
    bone.rotation_euler[0] = 0.6
    bone.keyframe_insert("rotation_euler", frame=15)
    for frame in (12, 18):
        bone.rotation_euler[0] = 0.0
        bone.keyframe_insert("rotation_euler", frame=frame)
    curled = {frame: evaluated_joints(scene, review.armature, frame) for frame in (15.0, 25.0)}
    review.first, review.last = 8, 22
    assert bpy.ops.mocap.resolve_range() == {"FINISHED"}
    assert 15 in [pin.frame for pin in review.pins]
    for frame, joints in curled.items():
        np.testing.assert_allclose(evaluated_joints(scene, review.armature, frame), joints, atol=2e-3)
