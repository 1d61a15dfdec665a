"""Gradients of a window by its free keys against central differences, and what the windows leave in place."""

from __future__ import annotations

import numpy as np
import pytest

from research.baselines.sequence import pose_prior
from research.baselines.windows import GAUSSIAN, OtherWindow, StretchedSlerp
from solver_backend.body.body import load_body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.fitters.model.subject import Subject, pose
from solver_backend.fitters.recipes.bundlemocap import KEYS, KeyState, Window
from solver_backend.geometry.interpolation import spherical_normalisation
from solver_backend.geometry.rotations import exp_so3
from solver_backend.priors.sposer import load_sposer
from solver_backend.residuals.positions import PositionTerm
from solver_backend.types import JointSet


def _keys(rng: np.random.Generator, count: int, kind: str) -> KeyState:
    turns = exp_so3(0.4 * rng.normal(size=(count, 3)))
    codes = 0.8 * rng.normal(size=(count, 32))
    return codes if kind == "slerp" else spherical_normalisation(codes), turns, 0.3 * rng.normal(size=(count, 3))


FRAMES = 13  # One more than a number that 1 to 4 divide: every key has a frame.
KINDS = [
    ("sider", 2), ("sider, root by slerp", 2), ("slerp", 1), ("sider", 1), ("sider", 3), ("sider", 4),
    ("sider, root by se3", 2), ("sider, root by se3", 3),
]  # fmt: skip
"""Curves and their free keys; SIDER-n of more than two keys is met where they are near."""


def _window(kind: str) -> Window:
    rng = np.random.default_rng(5)
    body = load_body()
    landmarks = keypoint_landmarks(body, JointSet.BODY_25)
    subject = Subject(body, landmarks, np.zeros(10), np.zeros((len(landmarks), 3)))
    time = np.linspace(0, 1, FRAMES)
    term = PositionTerm(rng.normal(size=(FRAMES, len(landmarks), 3)), rng.uniform(0.5, 2, (FRAMES, len(landmarks))))
    parts = term, 1.5, time, _keys(rng, 1, kind)
    if kind == "slerp":
        return OtherWindow(subject, pose_prior(), *parts, gaussian=True, latent_weight=0.7)
    if "root" in kind:
        return OtherWindow(subject, load_sposer(), *parts, root=kind.rpartition(" ")[2])
    return Window(subject, load_sposer(), *parts)


def _near(window: Window, state: KeyState) -> KeyState:
    """Return keys near the first one."""
    z, R, _ = window.first
    turns = np.cumsum([[0.1, 0, 0.2], [0.1, 0.1, -0.1], [0.0, 0.1, 0.0], [0.1, 0.0, 0.1]], axis=0)[: len(state[0])]
    return spherical_normalisation(z + 0.3 * (state[0] - z)), exp_so3(turns) @ R, state[2]


@pytest.mark.parametrize(("kind", "free"), KINDS)
def test_gradient_is_the_slope_along_random_tangents(kind: str, free: int) -> None:
    rng, window = np.random.default_rng(6), _window(kind)
    state, keys = _keys(rng, free, kind), GAUSSIAN if kind == "slerp" else KEYS
    if free > 2:  # keys a quarter of the sphere apart have points between them without a unique geodesic
        state = _near(window, state)
    gradient = keys.project(state, window.objective(state)[1])
    for part in range(3):
        ambient = [np.zeros((free, 32)), np.zeros((free, 3)), np.zeros((free, 3))]
        ambient[part] = rng.normal(size=ambient[part].shape)
        tangent = keys.project(state, tuple(ambient))
        h = 1e-5
        steps = (keys.retract(state, keys.combine(s * h, tangent, 0.0, tangent)) for s in (1, -1))
        up, down = (window.objective(step)[0] for step in steps)
        assert keys.inner(gradient, tangent) == pytest.approx((up - down) / (2 * h), rel=1e-5, abs=1e-6)


@pytest.mark.parametrize(("kind", "free"), KINDS)
def test_frames_run_from_the_fixed_key_through_all_to_the_last(kind: str, free: int) -> None:
    window, state = _window(kind), _keys(np.random.default_rng(7), free, kind)
    if free >= 2:
        state = _near(window, state)  # SIDER-n meets its inner keys where they are near enough
    frames = window.frames(state)
    keys = [tuple(part[0] for part in window.first)] + [tuple(part[i] for part in state) for i in range(free)]
    for frame, key in zip(range(0, FRAMES, (FRAMES - 1) // free), keys, strict=True):
        assert np.abs(frames.root[frame] - key[1]).max() < 1e-9
        assert np.abs(frames.transl[frame] - key[2]).max() < 1e-12
        assert np.abs(frames.local[frame] - window.prior.decode(key[0][None])[0]).max() < 1e-7


def test_the_cost_of_spherical_keys_is_the_data_term_alone() -> None:
    window, state = _window("sider"), _keys(np.random.default_rng(8), 2, "sider")
    points = pose(window.subject, window.frames(state)).points
    assert window.objective(state)[0] == pytest.approx(float(window.term(points, 1.5).cost.sum()), rel=1e-12)


def test_stretched_slerp_keeps_to_the_plane_of_its_keys_and_to_equal_keys() -> None:
    keys = np.array([[2.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    found = StretchedSlerp.between(keys[None, None], np.array([[0.0, 0.5, 1.0]])).value[0]
    assert np.allclose(found, [[2, 0, 0], [np.sqrt(2), np.sqrt(0.5), 0], [0, 1, 0]])
    same = StretchedSlerp.between(np.array([[[[0.3, 0.4], [0.3, 0.4]]]]), np.array([[0.25]]))
    assert np.allclose(same.value, [[0.3, 0.4]])
    assert np.allclose(same.vjp(np.array([[[1.0, 2.0]]])), [[0.75, 1.5], [0.25, 0.5]])


def test_derivatives_by_a_key_are_those_of_central_differences() -> None:
    rng = np.random.default_rng(5)
    keys, time, h = rng.normal(size=(1, 1, 2, 5)), rng.uniform(0.1, 0.9, (1, 3)), 1e-6
    found = StretchedSlerp.between(keys, time).jacobian(1)
    for d in range(5):
        step = np.zeros_like(keys)
        step[..., 1, d] = h
        ahead, behind = (StretchedSlerp.between(keys + s * step, time).value for s in (1, -1))
        np.testing.assert_allclose(found[..., d], (ahead - behind) / (2 * h), atol=1e-7)
