"""Gradients of a window by its free keys against central differences, and what the windows leave in place."""

from __future__ import annotations

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.fitters.baselines.windows import KEYS, KeyState, Window
from solver_backend.fitters.subject import Subject, pose
from solver_backend.geometry.rotations import exp_so3
from solver_backend.priors.sposer import load_sposer, spherical
from solver_backend.residuals.positions import PositionTerm
from solver_backend.types import JointSet


def _keys(rng: np.random.Generator, count: int) -> KeyState:
    turns = exp_so3(0.4 * rng.normal(size=(count, 3)))
    return spherical(rng.normal(size=(count, 32))), turns, 0.3 * rng.normal(size=(count, 3))


@pytest.fixture(scope="module")
def window() -> Window:
    rng = np.random.default_rng(5)
    body = load_body()
    landmarks = keypoint_landmarks(body, JointSet.BODY_25)
    subject = Subject(body, landmarks, np.zeros(10), np.zeros((len(landmarks), 3)))
    time = np.linspace(0, 1, 7)
    term = PositionTerm(rng.normal(size=(7, len(landmarks), 3)), rng.uniform(0.5, 2, (7, len(landmarks))))
    return Window(subject, load_sposer(), term, 1.5, time, _keys(rng, 1))


@pytest.mark.parametrize(("kind", "free"), [("by_sider2", 2), ("by_slerp", 1)])
def test_gradient_is_the_slope_along_random_tangents(window: Window, kind: str, free: int) -> None:
    rng = np.random.default_rng(6)
    state, objective = _keys(rng, free), getattr(window, kind)
    gradient = KEYS.project(state, objective(state)[1])
    for part in range(3):
        ambient = [np.zeros((free, 32)), np.zeros((free, 3)), np.zeros((free, 3))]
        ambient[part] = rng.normal(size=ambient[part].shape)
        tangent = KEYS.project(state, tuple(ambient))
        h = 1e-5
        up, down = (objective(KEYS.retract(state, KEYS.combine(s * h, tangent, 0.0, tangent)))[0] for s in (1, -1))
        # The decoder's derivative is taken in single precision.
        assert KEYS.inner(gradient, tangent) == pytest.approx((up - down) / (2 * h), rel=2e-4, abs=1e-5)


@pytest.mark.parametrize(("kind", "free"), [("sider2", 2), ("slerp", 1)])
def test_frames_run_from_the_fixed_key_to_the_last(window: Window, kind: str, free: int) -> None:
    state = _keys(np.random.default_rng(7), free)
    frames, _ = getattr(window, kind)(state)
    for frame, key in ((0, tuple(part[0] for part in window.first)), (-1, tuple(part[-1] for part in state))):
        assert np.abs(frames.root[frame] - key[1]).max() < 1e-9
        assert np.abs(frames.transl[frame] - key[2]).max() < 1e-12
        assert np.abs(frames.local[frame] - window.prior.decode(key[0][None])[0]).max() < 1e-7


def test_the_cost_is_the_data_term_alone(window: Window) -> None:
    state = _keys(np.random.default_rng(8), 2)
    points = pose(window.subject, window.sider2(state)[0]).points
    assert window.by_sider2(state)[0] == pytest.approx(float(window.term(points, 1.5).cost.sum()), rel=1e-12)
