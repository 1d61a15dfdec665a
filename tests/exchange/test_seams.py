"""Loops and joins: recorded and hand-keyed clips, and cycles that are known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.exchange import clips, seams
from solver_backend.exchange.errors import MotionInvalid
from solver_backend.exchange.motion_file import MotionFile
from solver_backend.exchange.props import Prop
from solver_backend.exchange.so3 import matrix_from_rotvec
from solver_backend.fitters.motion_import.import_motion import import_motion
from solver_backend.io.motions.foreign_skeleton import read_foreign_clip
from solver_backend.io.native.motion_file import as_file
from tests.support.addon_stand_in import Files
from tests.support.foreign_clips import cmu_take, write_cmu_skeleton


@pytest.fixture(scope="module")
def stride(files: Files) -> MotionFile:
    """A walk on a circle. Its joints swing with a period of exactly 30 frames."""
    motion = files.motion
    frames = np.arange(100)
    phase = 2 * np.pi * frames[:, None, None] / 30
    rng = np.random.default_rng(5)
    rotvec = 0.3 * rng.normal(size=(24, 3)) * np.sin(phase + rng.uniform(0, 6, size=(24, 3)))
    heading = 0.02 * frames
    upright = matrix_from_rotvec(np.array([np.pi / 2, 0.0, 0.0]))
    turn = matrix_from_rotvec(heading[:, None] * [0.0, 0.0, 1.0]) @ upright
    rotvec[:, 0] = clips.rotvec_from_matrix(turn @ matrix_from_rotvec(rotvec[:, 0]))
    pelvis = np.column_stack([2 * np.cos(heading), 2 * np.sin(heading), 1.0 + 0.02 * np.sin(2 * phase[:, 0, 0])])
    rest = clips.rest_joints(motion)
    _, joints = clips.pose_tree(rest, motion.body_layout.parents, rotvec, pelvis - rest[0])
    return MotionFile("stride", rotvec, pelvis - rest[0], motion.betas, 30.0, joints=joints)


def _around(cycle: MotionFile, placement: seams.Placement, times: int = 2) -> np.ndarray:
    """Return the joints of a cycle that is played several times, each time from where it ended."""
    laps = [cycle]
    for _ in range(times - 1):
        laps.append(placement.move(laps[-1]))
    return np.concatenate([lap.joints for lap in laps])


def test_a_known_cycle_is_found_and_not_changed(stride: MotionFile) -> None:
    loop = seams.find_loop(stride)
    assert loop.last - loop.first == 30, "the shortest of three equal ones"
    assert loop.gap.degrees < 1e-6 and loop.gap.mm < 1e-3 and abs(loop.gap.placement.angle) > 0.5
    assert np.allclose(loop.motion.joints, stride.joints[loop.first : loop.last], atol=1e-9)
    assert '"verb": "motion loop"' in loop.motion.provenance


def test_a_difference_is_hidden_without_a_step(stride: MotionFile) -> None:
    """An arm that drifts and a pelvis that sinks: the second lap follows the first one with its speed."""
    rotvec, pelvis = stride.rotvec.copy(), stride.joints[:, 0].copy()
    rotvec[:, 16, 2] += np.linspace(0.0, 0.4, 100)
    pelvis[:, 2] -= np.linspace(0.0, 0.08, 100)
    drifting = clips.repose(stride, rotvec, pelvis)
    loop = seams.close_cycle(drifting, 20, 50)
    assert 5 < loop.gap.degrees < 9 and loop.gap.mm > 10
    assert loop.seam_degrees < 0.5 and loop.seam_mm < 3.0
    played = _around(loop.motion, loop.gap.placement)
    steps = np.linalg.norm(np.diff(played, axis=0), axis=-1)
    seam, inside = steps[29].max(), np.delete(steps, 29, axis=0).max()
    assert seam < 1.02 * inside
    bends = np.linalg.norm(np.diff(played, n=2, axis=0), axis=-1).max(axis=1)
    assert bends[28:30].max() < 1.1 * np.delete(bends, [28, 29]).max()


def test_a_loop_can_stay_where_it_is(stride: MotionFile) -> None:
    loop = seams.find_loop(stride, stay=True)
    first, last = loop.motion.joints[0], loop.motion.joints[-1]
    step = np.linalg.norm(np.diff(loop.motion.joints, axis=0), axis=-1).max()
    assert np.linalg.norm(last - first, axis=-1).max() < 1.05 * step  # the next frame is the first one
    assert np.ptp(loop.motion.joints[:, 0, :2], axis=0).max() < 0.1


def test_a_loop_that_stays_takes_its_world_along(stride: MotionFile) -> None:
    """Deviations ahead of the body stay ahead of it, and a prop in the hand stays in the hand."""
    turn = matrix_from_rotvec(0.02 * np.arange(100)[:, None] * [0.0, 0.0, 1.0])
    six = (turn @ np.diag([1.0, 0.0, 0.0]) @ np.swapaxes(turn, -1, -2))[:, (0, 0, 0, 1, 1, 2), (0, 1, 2, 1, 2, 2)]
    box = Prop(
        "box",
        ("a",),
        np.zeros((1, 3)),
        clips.rotvec_from_matrix(turn),
        stride.joints[:, 20],
        np.zeros((100, 2)),
        np.ones(100, int),
    )
    moving = replace(stride, joint_covariance=np.repeat(six[:, None], 24, axis=1), props=(box,))
    loop = seams.find_loop(moving, stay=True)
    assert np.allclose(loop.motion.joint_covariance, loop.motion.joint_covariance[0], atol=1e-9)
    [kept] = loop.motion.props
    assert np.allclose(kept.transl, loop.motion.joints[:, 20], atol=1e-6)
    assert np.allclose(kept.rotvec, kept.rotvec[0], atol=1e-9)


def test_a_root_is_closed_with_its_body(stride: MotionFile) -> None:
    drift = stride.joints[:, 0] + np.sin(0.08 * np.arange(100))[:, None] * [0.03, 0.0, 0.0]
    moving = clips.root_motion(clips.repose(stride, stride.rotvec, drift))
    loop = seams.close_cycle(moving, 30, 60)
    laps = clips.without_root(loop.motion), clips.without_root(loop.gap.placement.move(loop.motion))
    assert np.allclose(laps[0].joints, laps[1].joints, atol=1e-9), "each lap is the same for its root"
    way = np.concatenate([loop.motion.root, loop.gap.placement.path(loop.motion.root)])
    steps = np.linalg.norm(np.diff(way, axis=0), axis=1)
    assert steps[29] < 1.1 * np.delete(steps, 29).max()
    played = np.concatenate([lap.joints for lap in laps])
    steps = np.linalg.norm(np.diff(played, axis=0), axis=-1).max(axis=1)
    assert steps[29] < 1.1 * np.delete(steps, 29).max()


def test_a_clip_that_does_not_repeat_says_so(stride: MotionFile) -> None:
    rotvec = stride.rotvec.copy()
    rotvec[:, 18, 1] += np.linspace(0.0, 2.5, 100)
    with pytest.raises(MotionInvalid, match=r"does not repeat.*frames \d+ to \d+, joints are .* degrees and .* mm"):
        seams.find_loop(clips.repose(stride, rotvec, stride.joints[:, 0]))
    with pytest.raises(MotionInvalid, match="Record two strides"):  # a finer rate does not bring an arm back
        seams.find_loop(clips.repose(stride, rotvec, stride.joints[:, 0]))
    for frames in (8, 1):
        with pytest.raises(MotionInvalid, match=f"has {frames} frames and no cycle of 0.4 s"):
            seams.find_loop(clips.take_frames(stride, np.arange(frames)))


def test_cycles_of_a_long_take_are_not_too_short(stride: MotionFile) -> None:
    """Above 900 frames, pairs around the best ones of a thinned take are compared, also a frame with itself."""
    rotvec = stride.rotvec[8] * np.sin(2.0 * np.pi * np.arange(3000) / 16.0)[:, None, None]
    rotvec[:, 0] = [np.pi / 2, 0.0, 0.0]
    rotvec[:, 16, 2] += np.linspace(0.0, 0.5, 3000)  # near cycles are better than far ones
    found = seams.find_cycles(clips.repose(stride, rotvec, np.zeros((3000, 3))))
    assert found[0][1] - found[0][0] == 16 and min(last - first for first, last in found) >= 12


def test_standing_still_is_no_loop_of_a_walk(stride: MotionFile) -> None:
    """Two seconds of rest before a walk repeat best, but they are no loop of it."""
    still = clips.take_frames(stride, np.concatenate([np.zeros(60, int), np.arange(100)]))
    first, last = seams.find_cycles(still)[0]
    assert first >= 55 and (last - first) % 30 == 0


def test_joined_clips_meet(stride: MotionFile) -> None:
    before, after = clips.take_frames(stride, np.arange(41)), clips.take_frames(stride, np.arange(10, 60))
    away = seams.Placement(2.0, np.array([3.0, -1.0, 0.0])).move(after)
    joined, seam = seams.join(before, away)
    # Frame 40 of the walk has the pose of frame 10: nothing has to be blended, and the walk goes on.
    assert seam.degrees < 1e-6 and joined.num_frames == 90
    assert np.allclose(joined.joints, stride.joints[:90], atol=2e-3)


def test_feet_that_stand_at_a_join_stay(stride: MotionFile) -> None:
    contacts = np.tile([True, False], (100, 1))
    standing = replace(stride, contacts=contacts)
    before, after = clips.trim(standing, 0, 30), clips.trim(standing, 47, 90)
    joined, seam = seams.join(before, after)
    assert seam.degrees > 5 and joined.contacts.all(axis=0)[0]
    feet = [motion.joints[at, [7, 10]].mean(axis=0) for motion, at in ((before, -1), (seam.placement.move(after), 0))]
    assert np.allclose(feet[0][:2], feet[1][:2], atol=1e-9)
    other = replace(after, body="other")
    with pytest.raises(MotionInvalid, match="Join motions of one body"):
        seams.join(replace(before, body="mine"), other)


def test_feet_that_stand_near_a_join_stay(stride: MotionFile) -> None:
    """One foot stands until the join and lands elsewhere after it, the other one stands throughout the join."""
    stands = np.zeros((2, 41, 2), bool)
    stands[0, 30:, 0] = stands[0, 35:, 1] = stands[1, 6:20, 0] = stands[1, :8, 1] = True
    before = replace(clips.take_frames(stride, np.arange(41)), contacts=stands[0])
    after = replace(clips.take_frames(stride, np.arange(24, 65)), contacts=stands[1])
    joined, seam = seams.join(before, after)
    moved = seam.placement.move(after)
    assert seam.mm > 30 and np.array_equal(joined.contacts, np.concatenate([stands[0, :-1], stands[1]]))
    assert np.allclose(joined.joints[30:40, 10], before.joints[30:40, 10], atol=1e-6)
    assert np.allclose(joined.joints[46:60, 10], moved.joints[6:20, 10], atol=1e-6)
    assert np.allclose(joined.joints[35:40, 11], before.joints[35:40, 11], atol=1e-6)
    slid = joined.joints[40:48, 11, :2] - moved.joints[:8, 11, :2]
    assert np.allclose(slid, slid[0], atol=1e-6), "it moves with its place in the first motion"
    assert np.allclose(joined.joints[:25], before.joints[:25], atol=1e-9)
    assert np.allclose(seams.rest_joints(joined), seams.rest_joints(stride), atol=1e-9)


def test_the_height_of_a_standing_foot_does_not_jump_at_a_join(stride: MotionFile) -> None:
    standing = replace(stride, contacts=np.ones((100, 2), bool))
    joined, _ = seams.join(clips.trim(standing, 0, 30), clips.trim(standing, 47, 90))
    assert np.abs(np.diff(joined.joints[20:40, 10:12, 2], axis=0)).max() < 0.04


@pytest.mark.slow
@pytest.mark.parametrize(("one", "two"), [("asfamc/16_15", "asfamc/16_35"), ("mb2/02_01", "mb2/02_03")])
def test_feet_of_recorded_clips_do_not_slide_at_a_join(one: str, two: str, shared_data: Path, tmp_path: Path) -> None:
    motions = []
    for take in (one, two):
        path = write_cmu_skeleton(tmp_path / f"{take[-5:]}.npz", cmu_take(shared_data / "motion_cmu" / f"{take}.npz"))
        motions.append(as_file(import_motion(*read_foreign_clip(path, "", "")[:2], load_body()).motion, take))
    first, joined = motions[0], seams.join(*motions)[0]
    near = slice(first.num_frames - round(first.fps), first.num_frames + round(first.fps))
    steps = np.linalg.norm(np.diff(joined.joints[near, 10:12, :2], axis=0), axis=-1)
    stands = joined.contacts[near][1:] & joined.contacts[near][:-1]
    assert stands.sum() > 10 and 1000.0 * steps[stands].mean() < 4.0


def test_a_join_tells_what_it_changes(stride: MotionFile) -> None:
    contacts = np.ones((100, 2), bool)
    resting = np.zeros((100, 24), bool)
    resting[:, 20:] = True
    second = replace(stride, contacts=contacts, resting=resting, joint_sigma=np.ones((100, 24)))
    joined, _ = seams.join(stride, second)
    assert joined.contacts is None and joined.joint_sigma is None
    assert not joined.resting[:99].any() and np.array_equal(joined.resting[99:], resting)
    notes = ". ".join(seams.join_notes(stride, second))
    assert "foot contacts" in notes and "standard deviations" in notes and "scaled" not in notes
    assert not seams.join_notes(stride, stride)


def test_a_body_without_legs_is_not_joined(stride: MotionFile) -> None:
    with pytest.raises(MotionInvalid, match="legs of the body have no length"):
        seams.join(stride, replace(stride, joints=np.zeros_like(stride.joints)))


def test_a_part_fades_in_and_out_of_a_motion(stride: MotionFile) -> None:
    moved = replace(stride, transl=stride.transl + [0.1, 0.0, 0.0], joints=stride.joints + [0.1, 0.0, 0.0])
    part = clips.note_edit(clips.take_frames(moved, np.arange(10, 31)), "denoise", prior="pose_ndf")
    found = seams.splice(stride, part, 10, (5, 3))
    away = found.joints[:, :, 0] - stride.joints[:, :, 0]
    assert np.abs(np.delete(away, slice(10, 31), axis=0)).max() < 1e-6
    np.testing.assert_allclose(away[15:28], 0.1, atol=1e-6)
    assert (np.diff(away[9:16, 0]) > 0.0).all() and (np.diff(away[27:32, 0]) < 0.0).all()
    assert clips.edits_of(found)[-1] == {"verb": "motion denoise", "prior": "pose_ndf", "frames": [10, 30]}
    whole = seams.splice(stride, part, 10)
    np.testing.assert_allclose(whole.joints[10:31], part.joints, atol=1e-6)
    with pytest.raises(MotionInvalid, match="does not fit"):
        seams.splice(stride, part, stride.num_frames - 5)


def test_feet_of_another_shape_stay_on_the_floor(stride: MotionFile) -> None:
    rest = 1.05 * clips.rest_joints(stride)
    transl = 1.05 * stride.joints[:, 0] - rest[0]
    _, joints = clips.pose_tree(rest, stride.body_layout.parents, stride.rotvec, transl)
    larger = replace(stride, transl=transl, joints=joints)
    joined, seam = seams.join(stride, larger)
    same, own = seams.join(stride, stride)
    assert np.allclose(joined.joints, same.joints, atol=1e-6) and abs(seam.mm - own.mm) < 1e-3
    assert "0.952 times" in seams.join_notes(stride, larger)[0]


@pytest.mark.slow
@pytest.mark.parametrize(
    "take", ["asfamc/16_15", "asfamc/16_21", "asfamc/16_32", "mb2/09_02", "mb2/35_17", "far/indian_13"]
)
def test_recorded_walks_runs_and_dances_loop(take: str, shared_data: Path, tmp_path: Path) -> None:
    path = write_cmu_skeleton(tmp_path / "clip.npz", cmu_take(shared_data / "motion_cmu" / f"{take}.npz"))
    source, roles, _ = read_foreign_clip(path, "", "")
    motion = as_file(import_motion(source, roles, load_body()).motion, take)
    if take.startswith("far"):
        motion = clips.resample(motion, 60.0)
    loop = seams.find_loop(motion)
    assert loop.seam_degrees <= 2.0 and loop.seam_mm <= 5.0
    assert np.array_equal(motion.contacts[loop.first], motion.contacts[loop.last])
    played = _around(loop.motion, loop.gap.placement)
    steps = np.linalg.norm(np.diff(played, axis=0), axis=-1)
    at = loop.motion.num_frames - 1
    assert steps[at].max() < np.delete(steps, at, axis=0).max() + 0.005
