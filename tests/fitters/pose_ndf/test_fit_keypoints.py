"""Fitting to 2D keypoints: equations against differences, a known pose and shape found again, torch as NumPy."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from solver_backend.body.body import load_body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.cameras.projection import project
from solver_backend.fitters.model.subject import PosedFrames, Subject, pose
from solver_backend.fitters.pose_ndf.complete import BENDS, KeypointObjective, KeypointSettings, fit_keypoints
from solver_backend.geometry.rotations import exp_so3
from solver_backend.residuals.reprojection import ReprojectionTerm
from solver_backend.types import SMPL_JOINTS, JointSet, Keypoints2D
from tests.support.pose_ndf_weights import random_prior
from tests.support.scenes import ring_of_cameras

COUNT = JointSet.BODY_25.num_keypoints
UPRIGHT = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])


def subject(betas: np.ndarray) -> Subject:
    body = load_body()
    return Subject(body, keypoint_landmarks(body, JointSet.BODY_25), betas, np.zeros((COUNT, 3)))


def frames(seed: int, spread: float, count: int = 2) -> PosedFrames:
    rng = np.random.default_rng(seed)
    local = exp_so3(spread * rng.standard_normal((count, 21, 3)))
    root = exp_so3(spread * rng.standard_normal((count, 3))) @ UPRIGHT
    return PosedFrames(root, local, np.array([0.0, 0.0, 0.9]) + spread * 0.3 * rng.standard_normal((count, 3)))


def term(truth: PosedFrames, betas: np.ndarray, views: int, like=np.zeros(1)) -> ReprojectionTerm:
    cameras = ring_of_cameras(views, distortion=0.0)
    points = pose(subject(betas), truth).points
    xy = project(cameras, points)
    keypoints = Keypoints2D(xy, np.ones(xy.shape[:3]), JointSet.BODY_25, 30.0)
    return ReprojectionTerm.of(cameras, keypoints, np.full(COUNT, 3.0), like)


@pytest.mark.parametrize("adaptive", [True, False])
def test_gradient_against_central_differences(tmp_path: Path, adaptive: bool) -> None:
    prior, betas = random_prior(tmp_path), 0.3 * np.ones(10)
    settings = KeypointSettings(bending=3.0, adaptive=adaptive)
    objective = KeypointObjective(subject(betas), prior, term(frames(0, 0.2), betas, 2), settings, 10.0)
    state, step = (frames(1, 0.25), betas), 1e-6
    _, system = objective.linearise(state)
    g = np.concatenate([system.g_shared, system.g_blocks.ravel()])
    for i in [*range(12), 14, 22, 24, 61, 66, 67, 78, 79, 100, 147]:
        move = step * np.eye(len(g))[i][None]
        up, down = (objective.linearise(objective.retract(state, sign * move))[0][0] for sign in (1, -1))
        assert g[i] == pytest.approx((up - down) / (2 * step), rel=1e-4, abs=1e-4)


def test_a_known_pose_and_shape_are_found_again(tmp_path: Path) -> None:
    betas = np.array([1.0, -0.8, *np.zeros(8)])
    truth = frames(2, 0.15)
    near = frames(3, 0.03)
    start = PosedFrames(near.root, near.local, truth.transl + 0.05)
    settings = KeypointSettings(manifold=1e-3, shape=1e-3, bending=1e-4)
    found = fit_keypoints(subject(np.zeros(10)), random_prior(tmp_path), term(truth, betas, 4), start, settings)
    points = [pose(subject(b), f).points for b, f in ((betas, truth), (found.betas, found.frames))]
    assert 1000 * np.linalg.norm(points[0] - points[1], axis=-1).mean() < 3.0
    assert found.cost < 1.0 and found.status


def test_bending_the_wrong_way_is_what_costs() -> None:
    wrong = {"left_knee": (-1, 0), "right_knee": (-1, 0), "left_elbow": (1, 1), "right_elbow": (-1, 1)}
    for column, axis, sign in BENDS:
        assert wrong[SMPL_JOINTS[column + 1]] == (sign, axis)


def test_numpy_against_torch(tmp_path: Path) -> None:
    prior, betas, truth, at = random_prior(tmp_path), 0.2 * np.ones(10), frames(4, 0.15), frames(5, 0.1)
    settings, person = KeypointSettings(), subject(betas)
    here = KeypointObjective(person, prior, term(truth, betas, 2), settings, 9.0).linearise((at, betas))
    tensors = Subject(person.body, person.landmarks, torch.as_tensor(betas), torch.as_tensor(person.offsets))
    observed = term(truth, betas, 2, torch.zeros(1, dtype=torch.float64))
    moved = PosedFrames(*(torch.as_tensor(x) for x in (at.root, at.local, at.transl)))
    there = KeypointObjective(tensors, prior, observed, settings, 9.0).linearise((moved, tensors.betas))
    assert float(there[0][0]) == pytest.approx(float(here[0][0]), rel=1e-9)
    for name in ("blocks", "coupling", "shared", "g_blocks", "g_shared"):
        expected = getattr(here[1], name)
        np.testing.assert_allclose(getattr(there[1], name).numpy(), expected, atol=1e-8 * np.abs(expected).max())
