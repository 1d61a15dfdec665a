"""Shots whose people move their hands: what hides points, what captures hold, and sets without hands as before."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.body_layout import SMPL, SMPL_HANDS
from solver_backend.exchange.joint_sets import HAND_POINTS
from solver_backend.fitters.hands.solve_hands import finger_turns_of
from solver_backend.geometry.rotations import exp_so3
from solver_backend.io.native.capture_file import read_capture
from solver_backend.io.native.motion_file import read_motion
from solver_backend.synthesis.studio.checked_values import StudioInvalid
from solver_backend.synthesis.studio.make_shot import make_shot
from solver_backend.synthesis.studio.person_hands import hidden_by_hands
from solver_backend.synthesis.studio.spec import Spec, spec_of
from solver_backend.synthesis.studio.stage import list_shots, set_up
from tests.support.open_hand import open_hand

SPEC = {
    "camera_arrays": [{"preset": "azure_kinect_3", "scale": 0.15}], "frames": 5, "fps": 10, "film": ["masks"],
    "seed": 3,
    "markers": None, "perturb": "detector", "hands": True,
}  # fmt: skip


def described(**more: object) -> Spec:
    return spec_of(json.loads(json.dumps(SPEC | more)))


def test_fingers_in_line_hide_each_other_and_a_flat_hand_shows_all() -> None:
    points = np.stack([open_hand(0) + [1.0, 0.0, 0.0], open_hand(1)])[None]
    above, aside = np.array([[0.0, 2.0, 0.05]]), np.array([[-3.0, 0.002, 0.1]])
    assert not hidden_by_hands(above, points).any()
    hidden = hidden_by_hands(aside, points)[0, 0, 1]
    behind = [HAND_POINTS.index(name) for name in ("index_pip", "middle_pip")]
    assert hidden[behind].all(), "the ring and the little finger are before them"
    assert not hidden[HAND_POINTS.index("pinky_pip")]
    one = np.stack([open_hand(0) + [-1.5, 0.0, 0.0], open_hand(1)])[None]
    assert hidden_by_hands(aside, one)[0, 0, 1].sum() >= hidden.sum(), "the other hand hides, too"


@pytest.fixture(scope="module")
def shot(tmp_path_factory: pytest.TempPathFactory) -> Path:
    spec = described()
    [one] = list_shots(spec)
    folder = tmp_path_factory.mktemp("shots")
    make_shot(spec, one, folder)
    return folder / one.name


def test_captures_hold_hands_and_the_motion_fingers(shot: Path) -> None:
    clean, perturbed = read_capture(shot / "clean.npz"), read_capture(shot / "perturbed.npz")
    assert clean.keypoints is not None and perturbed.keypoints is not None
    true, found = clean.keypoints.hands, perturbed.keypoints.hands
    assert true is not None and found is not None
    both = (true[..., 2] > 0) & (found[..., 2] > 0)
    off = np.linalg.norm(found[..., :2] - true[..., :2], axis=-1)[both]
    assert both.any() and 0.1 < np.median(off) < 30
    hidden = clean.truth["hand_hidden"]
    assert hidden.any() and not hidden.all()
    motion = read_motion(shot / "motion.npz")
    assert motion.body_layout == SMPL_HANDS
    points = clean.truth["hand_points"]
    knuckles = [SMPL_HANDS.joints.index(f"left_{finger}1") for finger in ("index", "pinky")]
    np.testing.assert_allclose(motion.joints[:, knuckles], points[:, 0, [5, 17]], atol=2e-4)
    turns = exp_so3(finger_turns_of(motion))
    assert np.abs(turns[1:] - turns[:-1]).max() > 0.01


def test_the_skin_moves_with_the_fingers() -> None:
    spec = described()
    [one] = list_shots(spec)
    stage = set_up(spec, one)
    frames = np.arange(2)
    apart = np.linalg.norm(stage.surface(frames) - set_up(described(hands=False), one).surface(frames), axis=-1)
    assert 0.01 < apart.max() < 0.2 and np.median(apart) < 1e-9


def test_sets_without_hands_stay(tmp_path: Path) -> None:
    spec = described(hands=False)
    [one] = list_shots(spec)
    make_shot(spec, one, tmp_path)
    clean = read_capture(tmp_path / one.name / "clean.npz")
    assert clean.keypoints is not None and clean.keypoints.hands is None and "hand_points" not in clean.truth
    assert read_motion(tmp_path / one.name / "motion.npz").body_layout == SMPL


def test_strange_bodies_have_no_fingers_to_move() -> None:
    with pytest.raises(StudioInvalid, match="no finger joints"):
        described(people={"count": 1, "strange": True})
