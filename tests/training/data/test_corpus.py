"""From recordings to poses: frames of reference, resampling, mirroring, repeats, and the split by subject."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from solver_backend.body.joint_limits import JOINT_LIMITS, swing_and_twist
from solver_backend.exchange.errors import FileDamaged, FileMissing, MotionInvalid, NonFiniteData
from solver_backend.geometry.rotations import exp_so3, log_so3
from solver_backend.training.data.augmentation import (
    beyond_reach,
    exchanged_limbs,
    mirrored,
    near_limits,
    penetrating,
)
from solver_backend.training.data.corpus import HELD_OUT, build_corpus, distinct_poses, split_corpus
from solver_backend.training.data.points import rotation_points
from solver_backend.training.data.rest_skeleton import MIRROR, REST_JOINTS
from solver_backend.training.data.retarget import RecordedClip, body_rotations, read_clip, resample
from solver_backend.training.data.shoulder_rhythm import with_shoulder_rhythm
from solver_backend.training.data.skeleton_maps import MAPS
from solver_backend.training.data.sources.clips import Clip, load_clips, without_faults
from solver_backend.training.sposer.accuracy import accuracy_by_source


def recorded(rotvec: np.ndarray, tpose: np.ndarray, family: int = 0) -> RecordedClip:
    names = list(MAPS[family].joints)
    parents = np.array([-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19])
    return RecordedClip("clip", names, parents, rotvec, tpose, 60.0)


def poses(count: int, scale: float = 0.4, seed: int = 0) -> np.ndarray:
    return exp_so3(scale * np.random.default_rng(seed).standard_normal((count, 21, 3)))


def test_tpose_is_the_zero_of_rotations() -> None:
    tpose = 0.3 * np.random.default_rng(0).standard_normal((22, 3))
    R = body_rotations(recorded(tpose[None], tpose))
    np.testing.assert_allclose(R, np.broadcast_to(np.eye(3), R.shape), atol=1e-12)


def test_bones_turn_as_recorded() -> None:
    rng = np.random.default_rng(1)
    tpose, rotvec = 0.3 * rng.standard_normal((22, 3)), 0.5 * rng.standard_normal((4, 22, 3))
    clip = recorded(rotvec, tpose)
    R = body_rotations(clip)

    def turned(local: np.ndarray) -> np.ndarray:
        out = [local[:, 0]]
        for joint in range(1, 22):
            out.append(out[clip.parents[joint]] @ local[:, joint])
        return np.stack(out, axis=1)

    expected = turned(exp_so3(rotvec)) @ np.swapaxes(turned(exp_so3(tpose[None])), -1, -2)
    got = turned(R)
    others = [j for j in range(22) if j not in (18, 19)]
    np.testing.assert_allclose(got[:, others], expected[:, others], atol=1e-10)
    # Forearms keep their direction; the twist about it is halved between elbow and wrist.
    np.testing.assert_allclose(got[:, [18, 19], :, 0], expected[:, [18, 19], :, 0], atol=1e-10)
    twist = [R[:, j, 2, 1] - R[:, j, 1, 2] for j in (20, 21)]
    hands = np.swapaxes(expected[:, [18, 19]], -1, -2) @ expected[:, [20, 21]]
    whole = 2 * np.arctan2(hands[..., 2, 1] - hands[..., 1, 2], 1 + np.trace(hands, axis1=-2, axis2=-1))
    half = 2 * np.arctan2(np.stack(twist, 1), 1 + np.trace(R[:, [20, 21]], axis1=-2, axis2=-1))
    np.testing.assert_allclose(half, 0.5 * whole, atol=1e-9)


def test_resampling_keeps_steady_turns() -> None:
    axis = np.array([0.2, -0.5, 0.7])
    R = exp_so3(np.arange(13)[:, None, None] / 60.0 * axis)
    half = resample(R, 60.0, 30.0)
    np.testing.assert_allclose(half, R[::2], atol=1e-12)
    other = resample(R, 60.0, 25.0)
    np.testing.assert_allclose(log_so3(other)[:, 0], np.arange(len(other))[:, None] / 25.0 * axis, atol=1e-9)
    assert len(other) == 6


def test_mirrored_pose_has_mirrored_joints() -> None:
    R = torch.as_tensor(poses(5))
    joints = rotation_points(R)[:, :24].numpy()
    flipped = rotation_points(mirrored(R))[:, :24].numpy()
    np.testing.assert_allclose(flipped, joints[:, list(MIRROR)] * (-1.0, 1.0, 1.0), atol=1e-12)
    np.testing.assert_allclose(mirrored(mirrored(R)).numpy(), R.numpy(), atol=1e-12)


def test_rest_skeleton_is_symmetric_and_faces_z() -> None:
    np.testing.assert_allclose(REST_JOINTS[list(MIRROR)] * (-1.0, 1.0, 1.0), REST_JOINTS, atol=1e-12)
    assert REST_JOINTS[1, 0] > 0 and REST_JOINTS[10, 2] > REST_JOINTS[7, 2]


def test_rhythm_keeps_the_arm() -> None:
    R = poses(20, scale=0.8)
    R[:, [12, 13]] = np.eye(3)
    out = with_shoulder_rhythm(R)
    for collar, shoulder in ((12, 15), (13, 16)):
        np.testing.assert_allclose(out[:, collar] @ out[:, shoulder], R[:, collar] @ R[:, shoulder], atol=1e-12)
    raised = np.broadcast_to(np.eye(3), (1, 21, 3, 3)).copy()
    raised[0, 15] = exp_so3(np.array([0.0, 0.0, 1.2]))
    raised[0, 16] = exp_so3(np.array([0.0, 0.0, -1.2]))
    turned = log_so3(with_shoulder_rhythm(raised)[0, [12, 13]])
    np.testing.assert_allclose(turned, [[0, 0, 0.22 * 1.2], [0, 0, -0.22 * 1.2]], atol=1e-9)


def test_distinct_poses_cover_all() -> None:
    x = np.random.default_rng(2).normal(size=(500, 3))
    kept = distinct_poses(x, 0.5, block=64)
    distance = np.linalg.norm(x[:, None] - x[kept][None], axis=-1)
    assert (distance.min(axis=1) <= 0.5).all()
    between = distance[kept] + 9 * np.eye(len(kept))
    assert between.min() > 0.5 and len(kept) < 400


def test_split_by_subject_leaves_out_renamed_takes() -> None:
    held = poses(40, seed=3).astype(np.float32)
    other = poses(40, seed=4).astype(np.float32)
    clips = [
        Clip("a", "08", held),
        Clip("b", "unknown", held[10:30]),
        Clip("c", "unknown", other),
        Clip("d", "02", held),
    ]
    training, validation = split_corpus(clips)
    assert training.names == ("c", "d") and validation.names == ("a",)
    np.testing.assert_array_equal(training.clip_start, np.repeat([0, 40], 40))
    np.testing.assert_array_equal(training.clip_end, np.repeat([40, 80], 40))


def test_exchanged_limbs_come_from_other_windows() -> None:
    windows = torch.as_tensor(poses(16, seed=5))[:, None]
    out = exchanged_limbs(windows, torch.Generator().manual_seed(0), 1.0)
    for joints in ((12, 15, 17, 19), (13, 16, 18, 20), (11, 14)):
        donors = [[bool((out[i][:, joints] == windows[k][:, joints]).all()) for k in range(16)] for i in range(16)]
        assert all(sum(row) == 1 for row in donors)
    assert not torch.equal(out, windows)


def test_hand_in_the_belly_penetrates() -> None:
    R = np.broadcast_to(np.eye(3), (2, 21, 3, 3)).copy()
    R[1, 15] = exp_so3(np.array([0.0, 0.0, -1.2]))
    R[1, 17] = exp_so3(np.array([0.0, 0.0, -1.5]))
    joints = rotation_points(torch.as_tensor(R))[:, :24]
    assert penetrating(joints).tolist() == [False, True]


def test_bad_clips_are_named(tmp_path: Path) -> None:
    names = np.array(MAPS[0].joints)
    fields = {
        "names": names, "parents": np.arange(-1, 21), "offsets": np.zeros((22, 3)), "rotvec": np.zeros((2, 22, 3)),
        "root": np.zeros((2, 3)), "fps": 60.0,
    }  # fmt: skip
    path = tmp_path / "clip.npz"
    with pytest.raises(FileMissing, match="clip.npz"):
        read_clip(path)
    path.write_bytes(b"not an archive")
    with pytest.raises(FileDamaged, match="cannot be read"):
        read_clip(path)
    np.savez(path, **{k: v for k, v in fields.items() if k != "fps"})
    with pytest.raises(FileDamaged, match="lacks fps"):
        read_clip(path)
    np.savez(path, **(fields | {"rotvec": np.full((2, 22, 3), np.nan)}))
    with pytest.raises(NonFiniteData, match="not a number"):
        read_clip(path)
    np.savez(path, **(fields | {"names": np.array([f"bone{i}" for i in range(22)])}))
    with pytest.raises(MotionInvalid, match="no known skeleton.*mb2"):
        body_rotations(read_clip(path))
    with pytest.raises(FileMissing, match="No training clips"):
        load_clips(tmp_path)


def test_joints_are_moved_towards_their_limits() -> None:
    windows = torch.as_tensor(poses(40, scale=0.1, seed=6)).unflatten(0, (10, 4)).float()
    moved = near_limits(windows, torch.Generator().manual_seed(0))
    same = torch.isclose(moved, windows, atol=1e-6).all(-1).all(-1).all(1)
    assert (~same).sum(1).tolist() == [2] * 10
    angles = swing_and_twist(moved[:, 1].double().numpy())
    range_share = (angles / np.where(angles < 0, JOINT_LIMITS[..., 0], JOINT_LIMITS[..., 1])).max(-1)
    assert (range_share[~same.numpy()] > 0.5).all() and (range_share[~same.numpy()] < 1.05).all()
    assert not beyond_reach(moved[:, 1]).any()
    broken = moved[:, 1].clone()
    broken[3, 3] = torch.as_tensor(exp_so3(np.array([-0.6, 0.0, 0.0]))).float()
    assert beyond_reach(broken).tolist() == [i == 3 for i in range(10)]


def test_stretches_with_faults_are_left_out() -> None:
    R = poses(30, scale=0.1).astype(np.float32)
    R[10:13, 3] = exp_so3(np.array([-1.5, 0.0, 0.0]))
    R[28, 3] = exp_so3(np.array([-1.5, 0.0, 0.0]))
    pieces = without_faults(Clip("mb2/x", "02", R))
    assert [len(p.rotations) for p in pieces] == [10, 15]
    np.testing.assert_array_equal(pieces[1].rotations, R[13:28])
    corpus = build_corpus(pieces)
    assert set(corpus.sources.tolist()) == {"mb2"} and len(corpus.sources) == 25
    figures = accuracy_by_source(corpus, lambda rotations: rotations)
    assert figures["mb2"]["mpjpe_mm"] == 0.0 and figures["mb2"]["poses"] == len(corpus.distinct)


@pytest.mark.shared
@pytest.mark.parametrize("name", ["mb2/02_01", "expmap/train_walking_1", "max/131_01", "daz/martial_03"])
def test_people_stand_upright_and_bend_the_right_way(shared_data: Path, name: str) -> None:
    clip = read_clip(shared_data / "motion_cmu" / f"{name}.npz")
    R = body_rotations(clip)[:, 1:]
    joints = rotation_points(R)[:, :24]
    assert np.median(joints[:, 15, 1]) > 0.45 and np.median(joints[:, 7, 1]) < -0.6
    knees, elbows = log_so3(R[:, [3, 4]]), log_so3(R[:, [17, 18]])
    assert np.percentile(knees[..., 0], 5) > np.radians(-10) and np.median(knees[..., 0]) > np.radians(5)
    assert np.median(elbows[:, 0, 1]) < 0 < np.median(elbows[:, 1, 1])


@pytest.mark.shared
def test_validation_subjects_are_unseen(shared_data: Path, tmp_path: Path) -> None:
    folder = tmp_path / "motion_cmu" / "mb2"
    folder.mkdir(parents=True)
    for name in ("02_01", "08_01", "13_29"):
        (folder / f"{name}.npz").symlink_to(shared_data / "motion_cmu" / "mb2" / f"{name}.npz")
    training, validation = split_corpus(load_clips(tmp_path))
    assert training.names == ("mb2/02_01",) and {n[4:6] for n in validation.names} <= HELD_OUT
    assert 0 < len(training.distinct) <= training.num_frames
    assert build_corpus([Clip("a", "02", training.rotations)]).num_frames == training.num_frames
