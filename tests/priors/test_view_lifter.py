"""The view lifter: what it looks at does not depend on where in the picture somebody stands, nor on how far away."""

import time
from dataclasses import replace

import numpy as np
import pytest

from solver_backend.exchange.errors import WeightsInvalid
from solver_backend.geometry.rotations import exp_so3
from solver_backend.priors.lifter import POINTS
from solver_backend.priors.view_lifter import (
    DEFAULT_WEIGHTS,
    MIDDLE,
    TOKEN,
    WINDOW,
    features,
    known_points,
    load_view_lifter,
    look_at,
    window_frames,
)
from solver_backend.priors.weights import read_weights, write_weights

RNG = np.random.default_rng(0)


def window(count: int = 4) -> tuple[np.ndarray, np.ndarray]:
    points = np.concatenate(
        [0.15 * RNG.normal(size=(count, WINDOW, len(POINTS), 2)), np.ones((count, WINDOW, 19, 1))], -1
    )
    return points, RNG.uniform(0.2, 1.0, (count, WINDOW, len(POINTS)))


def test_a_turn_of_the_camera_changes_neither_features_nor_the_persons_place_in_them() -> None:
    points, confidence = window()
    up = np.array([[0.1, -0.9, 0.3]] * 4)
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    straight = points[..., :2]
    turn = exp_so3(np.array([0.0, 0.25, 0.0]))
    turned = points @ turn.T
    turned = turned[..., :2] / turned[..., 2:]
    first = features(straight, confidence, up, look_at(straight, confidence))
    second = features(turned, confidence, up @ turn.T, look_at(turned, confidence))
    assert first.shape == (4, WINDOW, TOKEN)
    assert np.abs(first - second).max() < 0.12 < np.abs(first).max()
    middle = look_at(turned, confidence).R @ np.append(turned[0, MIDDLE].mean(0), 1.0)
    assert np.abs(middle[0, :2] / middle[0, 2]).max() < 0.1


def test_missing_points_are_not_looked_at() -> None:
    points, confidence = window()
    confidence[:, :, 5] = 0.0
    plain = features(points[..., :2], confidence, np.zeros((4, 3)), look_at(points[..., :2], confidence))
    points[:, :, 5] = 7.0
    other = features(points[..., :2], confidence, np.zeros((4, 3)), look_at(points[..., :2], confidence))
    np.testing.assert_array_equal(plain, other)


def test_points_are_found_by_name_and_frames_by_time() -> None:
    xy = RNG.normal(size=(3, 2, 2))
    xy[1, 0] = np.nan
    points, confidence = known_points(xy, np.ones((3, 2)), ("right_knee", "tail"))
    column = POINTS.index("right_knee")
    np.testing.assert_array_equal(points[0, column], xy[0, 0])
    assert confidence[:, column].tolist() == [1, 0, 1] and confidence.sum() == 2
    assert window_frames(5, 60.0)[2, MIDDLE + 1] == 4 and window_frames(5, 24.0)[2, MIDDLE - 5] == -2


def test_a_frame_costs_less_than_eight_milliseconds() -> None:
    lifter = load_view_lifter()
    points, confidence = 0.1 * RNG.normal(size=(300, len(POINTS), 2)), np.ones((300, len(POINTS)))
    lifter(points[:30], confidence[:30], POINTS, 30.0)
    costs = []
    for _ in range(3):
        began = time.thread_time()  # idle threads of the matrix products would count as work otherwise
        lifted = lifter(points, confidence, POINTS, 30.0)
        costs.append(time.thread_time() - began)
    assert min(costs) / 300 < 0.008
    np.testing.assert_allclose(np.linalg.det(lifted.root), 1.0, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(lifted.up, axis=1), 1.0, atol=1e-5)
    assert (lifted.sigma_m >= 0.0099).all() and DEFAULT_WEIGHTS.stat().st_size < 4e6


def test_weights_of_other_codes_are_refused(tmp_path) -> None:
    weights = read_weights(DEFAULT_WEIGHTS, "view_lifter")
    header = {key: weights.metadata[key] for key in ("heads", "points")}
    write_weights(tmp_path / "w.npz", replace(weights, metadata={**header, "sposer_sha256": "another"}))
    with pytest.raises(WeightsInvalid):
        load_view_lifter(tmp_path / "w.npz")
