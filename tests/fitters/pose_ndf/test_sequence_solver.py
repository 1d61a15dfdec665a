"""The sequence's equations: gradient and curvature against differences, NumPy against torch, takes in chunks."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from solver_backend.body.body import load_body
from solver_backend.body.markers import marker_landmarks
from solver_backend.exchange.errors import JobInvalid, PoseInvalid
from solver_backend.fitters.model.subject import PosedFrames, Subject, pose
from solver_backend.fitters.pose_ndf.complete import (
    CompleteSettings,
    DenoiseSettings,
    ManifoldWeights,
    PoseSequence,
    complete,
    denoise,
    missing_joints,
    solve_sequence,
)
from solver_backend.geometry.rotations import exp_so3
from solver_backend.priors.pose_ndf import TURN_METRIC, PoseNDF
from tests.support.layouts import POSE
from tests.support.pose_ndf_weights import random_prior

NAMES = ("LWRA", "RWRA", "CLAV", "LTOE", "RTOE", "LFHD", "LELB", "RKNE")
ALL = tuple(range(POSE.dof))
WEIGHTS = ManifoldWeights(2.0, 0.3, 1.5, level=0.015)


@pytest.fixture
def prior(tmp_path: Path) -> PoseNDF:
    return random_prior(tmp_path)


def subject() -> Subject:
    body = load_body()
    return Subject(body, marker_landmarks(body, NAMES), 0.5 * np.ones(10), np.zeros((len(NAMES), 3)))


def frames(count: int, seed: int, spread: float = 0.3) -> PosedFrames:
    rng = np.random.default_rng(seed)
    local = exp_so3(0.4 * rng.standard_normal((1, 21, 3)) + spread * rng.standard_normal((count, 21, 3)))
    return PosedFrames(exp_so3(0.2 * rng.standard_normal((count, 3))), local, 0.1 * rng.standard_normal((count, 3)))


def sequence(prior: PoseNDF, count: int, free: tuple[int, ...] = ALL, first: bool = False) -> PoseSequence:
    rng = np.random.default_rng(9)
    person = subject()
    observed = pose(person, frames(count, 5)).points
    before = None if first else observed[0] + 0.02
    seen = (rng.uniform(size=observed.shape[:2]) > 0.2).astype(float)
    return PoseSequence(person, prior, WEIGHTS, observed, seen, free, before)


def as_torch(value):
    if isinstance(value, PosedFrames):
        return PosedFrames(*(torch.as_tensor(x) for x in (value.root, value.local, value.transl)))
    return torch.as_tensor(value)


def dense(system, count: int) -> np.ndarray:
    n = system.diagonal.shape[1]
    H = np.zeros((count * n, count * n))
    for t in range(count):
        H[t * n : (t + 1) * n, t * n : (t + 1) * n] = system.diagonal[t]
        if t + 1 < count:
            H[t * n : (t + 1) * n, (t + 1) * n : (t + 2) * n] = system.upper[t]
            H[(t + 1) * n : (t + 2) * n, t * n : (t + 1) * n] = system.upper[t].T
    return H


@pytest.mark.parametrize(("first", "free"), [(True, ALL), (False, (0, 5, 48, 49, 50, 68))])
def test_gradient_against_central_differences(prior: PoseNDF, first: bool, free: tuple[int, ...]) -> None:
    problem, state, step = sequence(prior, 3, free, first), frames(3, 1), 1e-6
    _, system = problem.linearise(state)
    g = system.g.reshape(-1)
    for i in range(0, len(g), 1 if len(free) < 10 else 7):
        move = step * np.eye(len(g))[i][None]
        numeric = (
            problem.linearise(problem.retract(state, move))[0] - problem.linearise(problem.retract(state, -move))[0]
        )
        assert g[i] == pytest.approx(float(numeric[0]) / (2 * step), rel=1e-5, abs=1e-7)


def test_curvature_is_that_of_the_residuals(prior: PoseNDF) -> None:
    """H = Jᵀ J of the points' residuals, built here by differences of them, and the metric for the prior's."""
    problem, state, free = sequence(prior, 3, (1, 9, 50, 67)), frames(3, 2), 4
    _, system = problem.linearise(state)

    def residuals(x: PosedFrames) -> np.ndarray:
        points = pose(problem.subject, x).points
        arriving = np.concatenate([points[:1] - problem.before, points[1:] - points[:-1]])
        scale = np.sqrt(np.array([WEIGHTS.data, WEIGHTS.smoothness]) / len(NAMES))
        error = problem.seen[..., None] * (points - problem.observed)
        return np.concatenate([scale[0] * error.ravel(), scale[1] * arriving.ravel()])

    step, columns = 1e-6, []
    for i in range(3 * free):
        move = step * np.eye(3 * free)[i][None]
        columns.append(
            (residuals(problem.retract(state, move)) - residuals(problem.retract(state, -move))) / (2 * step)
        )
    J = np.stack(columns, axis=1)
    turns = [0.0, TURN_METRIC[2], TURN_METRIC[15], 0.0]
    expected = J.T @ J + WEIGHTS.manifold * np.diag(np.tile(turns, 3))
    np.testing.assert_allclose(dense(system, 3), expected, rtol=1e-4, atol=1e-6)
    excess = np.maximum(problem.prior.energy(state.local) - WEIGHTS.level, 0.0)
    squares = residuals(state) @ residuals(state) + WEIGHTS.manifold * (excess**2).sum()
    assert float(problem.linearise(state)[0][0]) == pytest.approx(0.5 * float(squares), rel=1e-12)


def test_numpy_against_torch(prior: PoseNDF) -> None:
    problem, state = sequence(prior, 4), frames(4, 3)
    body = problem.subject
    there = replace(
        problem, observed=as_torch(problem.observed), seen=as_torch(problem.seen), before=as_torch(problem.before),
        subject=Subject(body.body, body.landmarks, as_torch(body.betas), as_torch(body.offsets)),
    )  # fmt: skip
    a, b = solve_sequence(problem, state, 4), solve_sequence(there, as_torch(state), 4)
    assert float(a[1][0]) == pytest.approx(float(b[1][0]), rel=1e-9)
    np.testing.assert_allclose(b[0].local.numpy(), a[0].local, atol=1e-6)


def test_a_long_take_goes_on_from_chunk_to_chunk(prior: PoseNDF, monkeypatch) -> None:
    monkeypatch.setattr("solver_backend.fitters.pose_ndf.complete.CHUNK_FRAMES", 4)
    problem, state, told = sequence(prior, 10, first=True), frames(10, 4), []
    found, _ = solve_sequence(problem, state, 5, "Work", lambda *event: told.append(event))
    assert told == [("Work", 4, 10), ("Work", 8, 10), ("Work", 10, 10)] and found.local.shape == (10, 21, 3, 3)
    points = pose(problem.subject, found).points
    held = replace(problem, observed=problem.observed[4:8], seen=problem.seen[4:8], before=points[3])
    part = PosedFrames(found.root[4:8], found.local[4:8], found.transl[4:8])
    cost, _ = held.linearise(part)
    start, _ = held.linearise(PosedFrames(state.root[4:8], state.local[4:8], state.transl[4:8]))
    assert float(cost[0]) < 0.5 * float(start[0])


def test_denoising_is_smoother_and_its_gradient_vanishes_in_the_end(prior: PoseNDF) -> None:
    person, noisy = subject(), frames(12, 6, spread=0.1)
    settings = DenoiseSettings(ManifoldWeights(1.0, 0.01, 3.0), iterations=60)
    found = denoise(person, prior, noisy, 30.0, settings)
    speed = [np.linalg.norm(np.diff(pose(person, x).points, axis=0), axis=-1).mean() for x in (noisy, found)]
    assert speed[1] < 0.5 * speed[0]
    observed = pose(person, noisy).points
    problem = PoseSequence(person, prior, settings.weights, observed, np.ones(observed.shape[:2]), ALL)
    before, after = (np.abs(problem.linearise(x)[1].g).max() for x in (noisy, found))
    assert after < 0.05 * before
    kept = denoise(person, prior, noisy, 30.0, DenoiseSettings(move_root=False, iterations=3))
    np.testing.assert_array_equal(kept.root, noisy.root)
    np.testing.assert_array_equal(kept.transl, noisy.transl)


def test_completion_moves_the_missing_joints_alone_and_does_not_look_at_them(prior: PoseNDF) -> None:
    person, known = subject(), frames(5, 7, spread=0.05)
    missing = missing_joints(["left_arm", "head"])
    assert missing == (14, 15, 17, 19)
    settings = CompleteSettings(smoothness=0.0, iterations=6, starts=2)
    found = complete(person, prior, known, missing, 30.0, settings)
    others = [j for j in range(21) if j not in missing]
    np.testing.assert_array_equal(found.local[:, others], known.local[:, others])
    garbled = known.local.copy()
    garbled[:, list(missing)] = np.nan
    again = complete(person, prior, replace(known, local=garbled), missing, 30.0, settings)
    np.testing.assert_array_equal(again.local, found.local)
    start = known.local.copy()
    start[:, list(missing)] = np.eye(3)
    assert (prior.energy(found.local) ** 2).mean() < 0.9 * (prior.energy(start) ** 2).mean()


def test_bad_input_is_named(prior: PoseNDF) -> None:
    with pytest.raises(JobInvalid, match=r"no joint or limb tail.*left_arm"):
        missing_joints(["left_leg", "tail"])
    with pytest.raises(JobInvalid, match="No missing joint was specified"):
        missing_joints([])
    bad = frames(3, 0)
    with pytest.raises(PoseInvalid, match="not rotations"):
        denoise(subject(), prior, replace(bad, local=1.2 * bad.local), 30.0)
    local = bad.local.copy()
    local[1, 3] = np.nan
    with pytest.raises(PoseInvalid, match=r"NaN.*pose 1"):
        complete(subject(), prior, replace(bad, local=local), missing_joints(["head"]), 30.0)
