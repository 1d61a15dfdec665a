"""Links between frames: gradients against differences, and what they do to a trajectory."""

from __future__ import annotations

import numpy as np
import pytest

from research.baselines.links import JointTargets, SlowCodes, SlowJoints, low_frequencies
from research.baselines.sequence import DOF, Equations, Link, Sequence, States, pose_prior
from solver_backend.body.body import load_body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.fitters.model.subject import FrameObjective, Subject
from solver_backend.geometry.rotations import exp_so3
from solver_backend.residuals.pose_mixture import PoseMixtureTerm
from solver_backend.residuals.positions import PositionTerm
from solver_backend.types import JointSet

FRAMES = 5


@pytest.fixture(scope="module")
def sequence() -> Sequence:
    rng = np.random.default_rng(3)
    body = load_body()
    landmarks = keypoint_landmarks(body, JointSet.BODY_25)
    subject = Subject(body, landmarks, np.zeros(10), np.zeros((len(landmarks), 3)))
    term = PositionTerm(rng.normal(size=(FRAMES, len(landmarks), 3)), np.ones((FRAMES, len(landmarks))))
    return Sequence(subject, pose_prior(), FrameObjective((term,), (PoseMixtureTerm(),)), 0.5)


def _states(seed: int) -> States:
    rng = np.random.default_rng(seed)
    start = exp_so3(np.array([0.3, 0.2, -0.4]))
    turns = exp_so3(1e-3 * rng.normal(size=(FRAMES, 3)))
    return States(0.5 * rng.normal(size=(FRAMES, 32)), turns @ start, 0.1 * rng.normal(size=(FRAMES, 3)))


def _links(sequence: Sequence) -> dict[str, Link]:
    targets = np.random.default_rng(4).normal(size=(FRAMES, 72))
    return {
        "joints": SlowJoints(sequence.subject, 60.0, 2.0),
        "codes": SlowCodes(60.0, 10.0, 2.0),
        "targets": JointTargets(sequence.subject, targets, 0.1),
    }


@pytest.mark.parametrize("name", ["joints", "codes", "targets"])
def test_gradients_are_slopes_and_the_matrix_is_positive(sequence: Sequence, name: str) -> None:
    link, states, rng = _links(sequence)[name], _states(1), np.random.default_rng(2)

    def linked(at: States) -> Equations:
        return link(at, sequence.poses(at), sequence.d_pose_d_state(at))

    def cost(at: States) -> float:
        return float(linked(at).cost.sum())

    found = linked(states)
    for _ in range(4):
        step = rng.normal(size=(FRAMES, DOF))
        h = 1e-5
        slope = (cost(states.retract(h * step)) - cost(states.retract(-h * step))) / (2 * h)
        assert float((found.g * step).sum()) == pytest.approx(slope, rel=3e-3, abs=1e-3 * abs(slope) + 1e-3)
    quadratic = np.einsum("fa,fab,fb->", step, found.H, step)
    if found.upper is not None:
        quadratic += 2 * np.einsum("fa,fab,fb->", step[:-1], found.upper, step[1:])
    assert quadratic > 0


def test_solving_together_slows_the_joints(sequence: Sequence) -> None:
    alone = sequence.solve(_states(5), 100.0, 4)
    together = sequence.solve(alone, 100.0, 6, SlowJoints(sequence.subject, 60.0, 0.05))
    way = [np.abs(np.diff(s.transl, axis=0)).mean() for s in (alone, together)]
    assert way[1] < 0.2 * way[0]


def test_low_frequencies_keep_slow_waves_and_drop_fast_ones() -> None:
    time = np.arange(60) / 60.0
    slow, fast = np.cos(2 * np.pi * 2 * time), np.cos(2 * np.pi * 25 * time)
    kept = low_frequencies((slow + 0.5 * fast)[:, None], 30, 10)[:, 0]
    assert np.abs(kept - slow).max() < 0.2
    assert np.sqrt(np.mean((kept - slow) ** 2)) < 0.2 * np.sqrt(np.mean((0.5 * fast) ** 2))
