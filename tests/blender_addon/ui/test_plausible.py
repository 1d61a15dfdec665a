"""Pose-NDF on a range of a take: the range changes, the rest does not, and the take stays."""

from __future__ import annotations

import bpy
import numpy as np
import pytest

from blender_addon.scene.clips import played_motion


def played(mocap, take) -> np.ndarray:
    """Return the (F, J, 3) joints of a take that the body plays."""
    joints = played_motion(bpy.context.scene, mocap.review.armature, take).joints
    assert joints is not None
    return joints


@pytest.fixture
def chosen(mocap, solved_take):
    """Frames 18 to 22 of the take, counted from 0, as the range, and the joints before."""
    mocap.review.first, mocap.review.last = 19, 23
    return played(mocap, solved_take)


@pytest.mark.slow
def test_a_completed_limb_moves_alone_and_only_in_the_range(mocap, solved_take, chosen) -> None:
    assert bpy.ops.mocap.complete_limb(limb="left_arm") == {"FINISHED"}
    take = mocap.review.take
    assert take != solved_take and take["clip_of"] == solved_take.name
    motion = played_motion(bpy.context.scene, mocap.review.armature, take)
    moved = np.abs(motion.joints - chosen).max(axis=2) > 1e-3
    frames = np.flatnonzero(moved.any(axis=1))
    assert set(range(18, 23)) <= set(frames) and frames.min() > 18 - 16
    assert {"left_elbow", "left_wrist"} <= {motion.body_layout.joints[k] for k in np.flatnonzero(moved.any(axis=0))}
    assert not any("left" not in motion.body_layout.joints[k] for k in np.flatnonzero(moved.any(axis=0)))


def test_a_denoised_range_meets_the_frames_around_it(mocap, solved_take, chosen) -> None:
    assert bpy.ops.mocap.denoise_range() == {"FINISHED"}
    after = played(mocap, mocap.review.take)
    assert np.abs(after - chosen)[:3].max() < 1e-4, "0.25 s before the range"
    jump = np.linalg.norm(np.diff(after, axis=0), axis=-1).max(axis=1)
    assert jump.max() < 1.5 * np.linalg.norm(np.diff(chosen, axis=0), axis=-1).max()


def test_between_the_ends_of_the_range_lie_new_poses(mocap, solved_take, chosen) -> None:
    assert bpy.ops.mocap.fill_between() == {"FINISHED"}
    after = played(mocap, mocap.review.take)
    assert np.abs(after - chosen)[np.r_[0:19, 22 : len(after)]].max() < 1e-3
    assert len(np.flatnonzero(np.abs(after - chosen).max(axis=(1, 2)) > 1e-3)) and solved_take.name in bpy.data.actions


def test_a_range_without_frames_between_its_ends_is_refused(mocap, solved_take) -> None:
    mocap.review.first, mocap.review.last = 11, 12
    with pytest.raises(RuntimeError, match="2 frames, and at least 3"):
        bpy.ops.mocap.denoise_range()
