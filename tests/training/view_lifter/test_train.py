"""The view lifter's training: windows are what a camera sees, a few steps teach something, and that is exported."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from solver_backend.body.body import load_body
from solver_backend.body.rest_skeleton import REST_JOINTS
from solver_backend.exchange.joint_sets import SMPL_JOINTS
from solver_backend.priors.lifter import POINTS
from solver_backend.priors.sposer import load_sposer
from solver_backend.priors.view_lifter import MIDDLE, WINDOW, load_view_lifter
from tests.support.swaying_corpus import job as plain_job
from tests.support.swaying_corpus import turning
from training.data.points import rotation_points
from training.view_lifter import filming
from training.view_lifter.filming import Recordings, film, standing_place
from training.view_lifter.task import ViewLifterSettings, ViewLifterTask, train_view_lifter

SMALL = ViewLifterSettings(width=32, layers=1, heads=2)


@pytest.fixture
def faultless(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in (
        "TUMBLED",
        "TURNED_OVER",
        "BIAS_M",
        "THROWN",
        "LOST",
        "CUT",
        "EXCHANGED",
        "NO_TOES",
        "UP_DEG",
        "SHORT",
    ):
        monkeypatch.setattr(filming, name, 0.0)
    monkeypatch.setattr(filming, "NOISE_M", (1e-7, 1e-7))
    monkeypatch.setattr(filming, "DISTANCE_M", (200.0, 200.1))
    monkeypatch.setattr(filming, "OFF_AXIS", 0.0)
    monkeypatch.setattr(filming, "KNOWN_UP", 1.1)


def recordings(exchanged: int = 0) -> Recordings:
    return Recordings.of(turning(0), load_body(), exchanged, 0)


def test_recordings_without_the_pelvis_turn_are_left_out_and_copies_are_whole_clips() -> None:
    found = recordings(exchanged=1)
    assert len(found.local) == 2 * 60 and len(found.points) == 120
    assert found.clip_start.unique().tolist() == [0, 60] and found.clip_end.unique().tolist() == [60, 120]
    assert (found.centres >= 60).any() and (found.centres < 60).any()


def test_the_lowest_joint_stands_on_the_floor_and_does_not_slide() -> None:
    found = recordings()
    place = standing_place(found.local, found.root, found.clip_start)
    joints = torch.matmul(rotation_points(found.local)[:, :24], found.root.mT)
    joints = joints - joints[:, :1] + place[:, None]
    feet = joints[:, [7, 8, 10, 11]]
    assert feet[..., 1].min(dim=1).values.abs().max() < 1e-4
    lowest = feet[..., 1].argmin(dim=1)
    row = torch.arange(len(feet) - 1)
    moved = (feet[row + 1, lowest[1:]] - feet[row, lowest[1:]])[:, [0, 2]]
    assert moved.abs().max() < 1e-3


def test_what_is_filmed_is_what_is_true(faultless: None) -> None:
    found = recordings()
    footage = film(found, torch.arange(20, 52), torch.Generator().manual_seed(0))
    joints = torch.matmul(rotation_points(footage.local)[:, :24], footage.root.mT)
    names = ("left_hip", "right_hip", "left_knee", "right_knee", "left_elbow", "right_elbow")
    truth = joints[:, [SMPL_JOINTS.index(name) for name in names], :2]
    seen = 200.0 * footage.points[:, MIDDLE, [POINTS.index(name) for name in names]]
    off = (truth - truth.mean(1, keepdim=True)) - (seen - seen.mean(1, keepdim=True))
    assert off.norm(dim=-1).mean() < 0.06 < 0.3 < (truth - truth.mean(1, keepdim=True)).norm(dim=-1).mean()
    upright = torch.matmul(footage.root, torch.tensor([0.0, 1.0, 0.0]))
    assert ((upright * footage.up).sum(-1) > 0.9).all()
    assert REST_JOINTS[SMPL_JOINTS.index("head"), 1] > 1.4


def test_frames_beyond_a_take_are_missing() -> None:
    footage = film(recordings(), torch.zeros(8, dtype=torch.long), torch.Generator().manual_seed(0))
    assert footage.confidence.shape == (8, WINDOW, len(POINTS))
    assert not footage.confidence[:, :MIDDLE].any() and footage.confidence[:, MIDDLE:].any()


def test_training_teaches_and_exports_what_was_trained(tmp_path: Path) -> None:
    torch.set_num_threads(1)
    asked = plain_job(tmp_path, 80)
    order = type(asked)(**{**vars(asked), "training": turning(0), "validation": turning(0)})
    task = ViewLifterTask(turning(0), turning(0), load_body(), load_sposer(), SMALL, 16, 0)
    untrained = task.evaluate(task.model)
    finished = train_view_lifter(order, SMALL)
    assert finished.metrics["joints_mm"] < 0.8 * untrained["joints_mm"]
    lifter = load_view_lifter(finished.weights)
    assert (lifter.layers, lifter.heads, lifter.arrays["place"].shape) == (1, 2, (WINDOW, 32))
    points = np.random.default_rng(0).normal(0, 0.1, (5, len(POINTS), 2))
    lifted = lifter(points, np.ones((5, len(POINTS))), POINTS, 30.0)
    assert np.isfinite(lifted.sigma_m).all() and lifted.root.shape == (5, 3, 3)
    card = finished.weights.with_suffix(".md").read_text(encoding="utf-8")
    assert lifter.metadata["command"].partition(" --")[2] in card and "joints_mm" in card
