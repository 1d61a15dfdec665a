"""Hands beside a body: found where they are, written with the motion, and harmless where they are wrong."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.body.hands import by_finger
from solver_backend.exchange.body_layout import SMPL, SMPL_HANDS
from solver_backend.exchange.joint_sets import SIDES
from solver_backend.fitters.pipeline import solve
from solver_backend.io.native.motion_file import read_motion, write_motion
from solver_backend.priors.hand_prior import load_hand_prior
from solver_backend.synthesis.studio.person_hands import HandFaults, detect_hands
from solver_backend.types import FLAG_RESTING, Capture, Motion
from tests.support.handed_take import HandedTake, handed_take

FRAMES = 30
BODY = 20
"""Joints before the wrists."""


@lru_cache(maxsize=1)
def take() -> HandedTake:
    return handed_take(FRAMES, seed=2)


def with_hands(hands: np.ndarray | None) -> Capture:
    capture = take().capture
    assert capture.keypoints is not None
    return replace(capture, keypoints=replace(capture.keypoints, hands=hands))


def hands() -> np.ndarray:
    keypoints = take().capture.keypoints
    assert keypoints is not None and keypoints.hands is not None
    return keypoints.hands.copy()


@lru_cache(maxsize=2)
def solved(with_fingers: bool) -> Motion:
    return solve(with_hands(hands() if with_fingers else None)).motion


def finger_errors(motion: Motion) -> np.ndarray:
    """Return (2, F, 15) distances of finger joints in mm."""
    errors = []
    for side, name in enumerate(SIDES):
        found = by_finger(motion.joints[:, list(SMPL_HANDS.group(f"{name}_hand"))])
        truth = take().hands.points[:, side, 1:].reshape(-1, 5, 4, 3)[:, :, :3]
        errors.append(1000 * np.linalg.norm(found - truth, axis=-1).reshape(len(found), -1))
    return np.stack(errors)


def test_fingers_are_where_they_are() -> None:
    motion = solved(True)
    assert motion.body_layout.joints == SMPL_HANDS.joints
    errors = finger_errors(motion)
    assert np.sqrt((errors**2).mean()) < 15
    wrists = [motion.joints[:, 20 + side] - take().hands.points[:, side, 0] for side in range(2)]
    plain = [solved(False).joints[:, 20 + side] - take().hands.points[:, side, 0] for side in range(2)]
    assert np.linalg.norm(wrists, axis=-1).mean() < np.linalg.norm(plain, axis=-1).mean()


def test_a_body_without_hands_is_solved_as_ever_and_hands_move_arms_alone() -> None:
    plain, motion = solved(False), solved(True)
    assert plain.body_layout.joints == SMPL.joints
    assert "hands" not in plain.provenance
    arms = [SMPL.joints.index(f"{s}_{part}") - 1 for s in SIDES for part in ("collar", "shoulder", "elbow", "wrist")]
    others = np.delete(np.arange(21), arms)
    before, after = (m.body_pose.reshape(FRAMES, -1, 3)[:, others] for m in (plain, motion))
    np.testing.assert_array_equal(before, after)
    for name in ("betas", "global_orient", "transl", "contacts"):
        np.testing.assert_array_equal(getattr(plain, name), getattr(motion, name))


def test_a_motion_with_fingers_comes_back_from_its_file(tmp_path) -> None:
    back = read_motion(write_motion(tmp_path / "m.npz", solved(True)))
    assert back.body_layout.joints == SMPL_HANDS.joints
    np.testing.assert_allclose(back.body_pose, solved(True).body_pose, atol=1e-6)
    np.testing.assert_allclose(back.joints, solved(True).joints, atol=1e-5)
    assert back.provenance["hands"]["left"]["seen_percent"] > 80


def test_ellipsoids_of_fingers_are_of_their_errors_size() -> None:
    motion = solved(True)
    assert motion.joint_sigma is not None
    fingers = motion.joint_sigma[:, 22:]
    assert 0.004 < np.median(fingers) < 0.02
    assert motion.resting is None or not motion.resting[:, 22:].all()


@pytest.mark.slow
def test_a_hand_that_nobody_sees_rests_relaxed_and_is_flagged() -> None:
    alone = hands()
    alone[:, :, 1] = np.nan
    motion = solve(with_hands(alone)).motion
    right = list(SMPL_HANDS.group("right_hand"))
    assert motion.resting is not None and motion.flags is not None
    assert motion.resting[:, right].all()
    assert (motion.flags & FLAG_RESTING).all()
    relaxed = take().hands.skeletons[1].local_rotations(load_hand_prior().mean[None])[0]
    assert np.trace(relaxed, axis1=-2, axis2=-1).max() <= 3.0
    turns = np.linalg.norm(motion.body_pose.reshape(FRAMES, -1, 3)[:, np.array(right) - 1], axis=-1)
    assert turns.std(axis=0).max() < 1e-6
    np.testing.assert_array_equal(motion.body_pose[:, : 3 * 12], solved(True).body_pose[:, : 3 * 12])  # before the arms


@pytest.mark.slow
def test_exchanged_hands_are_found_and_named() -> None:
    wrong = hands()
    wrong[1, 8:22] = wrong[1, 8:22, ::-1]
    motion = solve(with_hands(wrong)).motion
    codes = {item["code"]: item for item in motion.provenance["diagnostics"]}
    assert codes["hands_exchanged"]["where"]["cameras"] == [take().capture.cameras.names[1]]  # type: ignore[union-attr]
    assert np.sqrt((finger_errors(motion) ** 2).mean()) < 1.1 * np.sqrt((finger_errors(solved(True)) ** 2).mean())


@pytest.mark.slow
def test_a_wrong_hand_moves_no_wrist_far() -> None:
    """One view shows somebody else's fingers at the right place: its points are outliers."""
    wrong = hands()
    wrong[0, :, 0, 1:, :2] += np.random.default_rng(0).normal(0, 40, (FRAMES, 20, 2))
    motion = solve(with_hands(wrong)).motion
    moved = np.linalg.norm(motion.joints[:, 20] - solved(True).joints[:, 20], axis=-1)
    assert np.median(moved) < 0.015


@pytest.mark.slow
def test_a_hand_in_one_view_alone_is_ridden_out() -> None:
    single = hands()
    single[1:, :, 0] = np.nan
    motion = solve(with_hands(single)).motion
    moved = np.linalg.norm(motion.joints[:, 20] - take().hands.points[:, 0, 0], axis=-1)
    plain = np.linalg.norm(solved(False).joints[:, 20] - take().hands.points[:, 0, 0], axis=-1)
    assert moved.mean() < plain.mean() + 0.01
    assert motion.joint_sigma is not None and solved(True).joint_sigma is not None
    left = list(SMPL_HANDS.group("left_hand"))
    assert np.median(motion.joint_sigma[:, left]) > np.median(solved(True).joint_sigma[:, left])  # type: ignore[index]


@pytest.mark.slow
@pytest.mark.parametrize(
    "faults", [HandFaults(gloved=True), HandFaults(held=True)], ids=["gloves", "a thing in the hand"]
)
def test_hands_that_a_detector_guesses_leave_the_body_alone_and_fingers_unsure(faults: HandFaults) -> None:
    person, cameras = take().person, take().capture.cameras
    assert cameras is not None
    found = detect_hands(cameras, take().hands.points, take().hidden, 30.0, faults, np.random.default_rng(3))
    motion = solve(with_hands(found)).motion
    truth = take().hands.points[:, :, 0]
    wrists, plain = (np.linalg.norm(m.joints[:, 20:22] - truth, axis=-1).mean() for m in (motion, solved(False)))
    assert wrists < plain + 0.005
    assert person.transl.shape == motion.transl.shape
    assert motion.joint_sigma is not None and solved(True).joint_sigma is not None
    unsure, sure = (np.median(m.joint_sigma[:, 22:]) for m in (motion, solved(True)))  # type: ignore[index]
    assert unsure > 1.3 * sure
    errors = finger_errors(motion)
    assert np.median(errors) < 2.0 * 1000 * unsure


@pytest.mark.slow
def test_small_hands_count_for_what_they_are() -> None:
    """Hands of 10 px are guesses: deviations grow more than hands shrink."""
    cameras = take().capture.cameras
    assert cameras is not None
    far = replace(cameras, K=cameras.K * np.array([0.2, 0.2, 1.0])[:, None], image_size=cameras.image_size // 5)
    found = detect_hands(far, take().hands.points, take().hidden, 30.0, HandFaults(), np.random.default_rng(3))
    capture = take().capture
    assert capture.keypoints is not None
    keypoints = replace(capture.keypoints, xy=0.2 * capture.keypoints.xy, hands=found)
    motion = solve(replace(capture, cameras=far, keypoints=keypoints)).motion
    assert motion.joint_sigma is not None and solved(True).joint_sigma is not None
    assert np.median(motion.joint_sigma[:, 22:]) > 1.5 * np.median(solved(True).joint_sigma[:, 22:])
    errors = finger_errors(motion)
    assert np.median(errors) < 2000 * np.median(motion.joint_sigma[:, 22:])


@pytest.mark.parametrize("frames", [4, pytest.param(5, marks=pytest.mark.slow)])
def test_short_takes_have_hands(frames: int) -> None:
    capture = with_hands(hands())
    assert capture.keypoints is not None
    short = replace(capture, keypoints=capture.keypoints.frames(0, frames), truth={})
    assert solve(short).motion.body_layout.joints == SMPL_HANDS.joints


@pytest.mark.slow
def test_a_body_without_finger_joints_is_named(monkeypatch) -> None:
    import solver_backend.fitters.pipeline as prepare

    plain = replace(load_body(), id="another")
    monkeypatch.setattr(prepare, "load_chosen_body", lambda _: plain)
    motion = solve(with_hands(hands())).motion
    assert motion.body_layout.joints == SMPL.joints
    assert "hands_without_fingers" in {item["code"] for item in motion.provenance["diagnostics"]}
