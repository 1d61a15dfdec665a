"""From recorded skeletons to ours: frames of reference, the hand's twist, resampling, real people."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from solver_backend.geometry.rotations import exp_so3, log_so3
from solver_backend.io.motions.recorded_clip import MAPS, RecordedClip, body_rotations
from training.data.points import rotation_points
from training.data.sources.clips import read_clip, resample


def recorded(rotvec: np.ndarray, tpose: np.ndarray) -> RecordedClip:
    names = list(next(m for m in MAPS if m.family == "mb2").joints)
    parents = np.array([-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19])
    return RecordedClip("clip", names, parents, rotvec, tpose, 60.0)


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


@pytest.mark.shared
@pytest.mark.parametrize(
    "name",
    [
        "mb2/02_01",
        "expmap/train_walking_1",
        "max/131_01",
        "daz/martial_03",
        "asfamc/135_03",
        "daz_more/06_01",
        "segments/walk_39_01_1",
        "far/indian_04",
    ],
)
def test_people_stand_upright_and_bend_the_right_way(shared_data: Path, name: str) -> None:
    clip = read_clip(shared_data / "motion_cmu" / f"{name}.npz")
    R = body_rotations(clip)[:, 1:]
    joints = rotation_points(R)[:, :24]
    assert np.median(joints[:, 15, 1]) > 0.45 and np.median(joints[:, 7, 1]) < -0.6
    knees, elbows = log_so3(R[:, [3, 4]]), log_so3(R[:, [17, 18]])
    assert np.percentile(knees[..., 0], 5) > np.radians(-10) and np.median(knees[..., 0]) > np.radians(5)
    assert np.median(elbows[:, 0, 1]) < 0 < np.median(elbows[:, 1, 1])
