"""Views that err on whole hands: their offsets are eliminated exactly, measured per take, and lengthen no bone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.body.hands import hand_of_shape, with_fingers
from solver_backend.cameras.projection import CameraArrays, project
from solver_backend.fitters.hands.measured_hands import HandViewTerm, hand_size, likely_size, locate_hands
from solver_backend.fitters.hands.shown_hands import HandViews
from solver_backend.residuals.reprojection import ReprojectionTerm
from tests.support.moving_hand import hand_problem
from tests.support.scenes import ring_of_cameras

CAMERAS = ring_of_cameras(4)
OWN, WHOLE = 3.0, 6.0
"""Pixels."""


def term_of(points: np.ndarray, noise: float, seed: int = 0) -> HandViewTerm:
    rng = np.random.default_rng(seed)
    px = project(CAMERAS, points)
    confidence = np.where(rng.random(px.shape[:-1]) < 0.15, 0.0, rng.uniform(0.5, 1.0, px.shape[:-1]))
    xy = px + noise * (OWN * rng.normal(size=px.shape) + WHOLE * rng.normal(size=(*px.shape[:2], 1, 2)))
    own = ReprojectionTerm(CameraArrays.of(CAMERAS, xy), xy, confidence / OWN**2, confidence)
    return HandViewTerm(own, np.full(4, WHOLE))


def hand_points(frames: int) -> np.ndarray:
    """Return (F, 21, 3) of a hand that moves between the cameras."""
    problem, states = hand_problem(frames)
    return problem.points(states)


def test_the_gradient_is_the_costs_derivative() -> None:
    points = hand_points(3)
    term, step = term_of(points, 1.0), 1e-6
    for scale, tolerance in ((1e6, 1e-5), (4.0, 0.02)):
        gradient = term(points, scale).gradient
        for index in ((0, 4, 0), (1, 9, 2), (2, 17, 1)):
            moved = [points.copy() for _ in range(2)]
            moved[0][index] -= step
            moved[1][index] += step
            slope = (term(moved[1], scale).cost - term(moved[0], scale).cost)[index[0]] / (2 * step)
            assert abs(gradient[index] - slope) < tolerance * np.abs(gradient[index[0]]).max()


def test_the_matrix_is_that_of_points_and_offsets_with_the_offsets_eliminated() -> None:
    points = hand_points(1)
    term, step = term_of(points, 0.0), 1e-6
    found = term(points, 1e6)
    assert found.shared is not None
    rows = found.shared[0].reshape(found.shared.shape[1], -1)
    whole = -rows.T @ rows
    for site in range(21):
        own = slice(3 * site, 3 * site + 3)
        whole[own, own] += found.information[0, site]
    for column in (0, 13, 40, 62):
        moved = [points.copy() for _ in range(2)]
        for sign, part in zip((-1, 1), moved, strict=True):
            part.reshape(-1)[column] += sign * step
        slope = (term(moved[1], 1e6).gradient - term(moved[0], 1e6).gradient).ravel() / (2 * step)
        np.testing.assert_allclose(slope, whole[:, column], rtol=1e-3, atol=1e-4 * np.abs(whole).max())


def test_a_wrong_hand_pulls_less_than_one_that_is_a_little_off() -> None:
    points = hand_points(1)
    term = term_of(points, 0.0)

    def pull(px: float) -> float:
        xy = term.points.xy.copy()
        xy[0, 0] += [px, 0.0]
        return float(np.abs(replace(term, points=replace(term.points, xy=xy))(points, 4.0).gradient[0].sum(0)).max())

    assert pull(100.0) < pull(10.0)


@pytest.mark.parametrize("noise", [0.5, 1.5])
def test_noise_is_measured_and_bones_are_as_long_as_they_are(noise: float) -> None:
    body = with_fingers(load_body())
    skeleton = hand_of_shape(body, np.zeros(10), 1)
    rng = np.random.default_rng(3)
    own = skeleton.sites(skeleton.pose(np.tile(skeleton.rest_angles, (80, 1))), skeleton.keypoints())
    term = term_of(own + np.array([0.0, 0.0, 1.2]) + rng.uniform(-0.2, 0.2, (80, 1, 3)), noise, seed=5)
    xy, confidence = (np.stack([a, a], axis=2) for a in (term.points.xy, term.points.confidence))
    confidence[:, :, 0] = 0.0
    found = locate_hands(HandViews(CAMERAS, xy, confidence))
    assert list(found) == [1]
    assert np.median(found[1].noise.own_px) == pytest.approx(noise * OWN, rel=0.25)
    np.testing.assert_allclose(found[1].noise.whole_px, noise * WHOLE, rtol=0.4)
    size = hand_size(skeleton, found[1].points, found[1].spread_m2)
    assert size.scale == pytest.approx(1.0, abs=max(0.01, 2.5 * size.sigma))
    assert size.sigma < 0.06
    large = hand_size(skeleton, 1.1 * found[1].points, 1.21 * found[1].spread_m2)
    assert 1.0 < likely_size([large, large]) < large.scale, "what is measured, drawn to people of that build"
    assert likely_size([]) == 1.0
