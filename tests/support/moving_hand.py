"""A hand that moves smoothly through poses that people take, and its wrist on a path."""

from __future__ import annotations

import numpy as np

from solver_backend.body.hand_skeleton import NUM_ANGLES, HandSkeleton
from solver_backend.fitters.hands.solve_hand import DOF, FINGERS, SHIFT, TURN, HandProblem, WristPath
from solver_backend.geometry.rotations import exp_so3
from solver_backend.priors.hand_prior import load_hand_prior
from solver_backend.residuals.positions import PositionTerm
from tests.support.open_hand import open_hand

FPS = 30.0


def smooth(frames: int, width: int, rng: np.random.Generator, rate: float = 0.6) -> np.ndarray:
    """Return (F, n) sums of slow waves of unit variance."""
    times = np.arange(frames)[:, None, None] / FPS
    waves = rng.uniform(0.1, rate, (1, width, 4))
    return np.sin(2 * np.pi * (times * waves + rng.uniform(0, 1, (1, width, 4)))).sum(-1) / np.sqrt(2.0)


def drawn_states(frames: int, seed: int) -> np.ndarray:
    """Return (F, D) states: angles within the prior and the joints' ranges, the wrist off its path by what is usual."""
    rng, prior = np.random.default_rng(seed), load_hand_prior()
    states = np.zeros((frames, DOF))
    drawn = prior.mean + 0.7 * smooth(frames, NUM_ANGLES, rng) @ np.linalg.cholesky(prior.covariance).T
    states[:, FINGERS] = np.clip(drawn, prior.low, prior.high)
    states[:, TURN] = 0.3 * smooth(frames, 3, rng)
    states[:, SHIFT] = 0.01 * smooth(frames, 3, rng)
    return states


def wrist_path(frames: int, seed: int) -> WristPath:
    """Return a wrist that turns and wanders a metre above the floor."""
    rng = np.random.default_rng(seed + 100)
    turns = exp_so3(0.5 * smooth(frames, 3, rng) + [1.0, 0.0, 0.0])
    return WristPath(
        turns, [0.1, 0.0, 1.1] + 0.1 * smooth(frames, 3, rng), np.tile(np.eye(3) * 0.015**2, (frames, 1, 1))
    )


def hand_problem(frames: int, seed: int = 0, side: int = 1) -> tuple[HandProblem, np.ndarray]:
    """Return a hand whose 21 points are measured to 3 mm, and the true states (F, D)."""
    skeleton, path = HandSkeleton.of_points(open_hand(side), side), wrist_path(frames, seed)
    states, nothing = drawn_states(frames, seed), np.zeros((frames, 21))
    blank = PositionTerm(np.zeros((frames, 21, 3)), nothing)
    problem = HandProblem(skeleton, skeleton.keypoints(), path, blank, load_hand_prior(), FPS)
    points = problem.points(states) + np.random.default_rng(seed + 7).normal(0, 0.003, (frames, 21, 3))
    term = PositionTerm(points, nothing + 1 / 0.003**2)
    return HandProblem(skeleton, skeleton.keypoints(), path, term, load_hand_prior(), FPS), states
