"""Control points of the spline: nearest to the parabolas of all, where those are one parabola the same curve."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver_backend.fitters.model.keyframe_curve import key_poses
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout, control_points, lagrange
from tests.support.random_keys import random_keys
from tests.support.toy_prior import ToyPrior

LAYOUT = KeyframeLayout(np.array([3, 13, 22, 33, 43]))


def _weights(layout: KeyframeLayout) -> tuple[np.ndarray, np.ndarray]:
    """Return dense (F, K) weights of the spline and of the parabolas."""
    frames, rows = layout.frames, np.arange(len(layout.frames))
    window, time = layout.positions(frames)
    spline, parabolas = np.zeros((len(frames), layout.num_keys + 2)), np.zeros((len(frames), layout.num_keys))
    for k in range(5):
        spline[rows, 2 * window + k] += layout.spline_shares(window, time)[:, k]
    for k in range(3):
        parabolas[rows, 2 * window + k] += lagrange(time)[:, k]
    return spline[:, 1:-1], parabolas


def test_they_are_the_least_squares_solution() -> None:
    keys, (spline, parabolas) = random_keys(LAYOUT.num_keys), _weights(LAYOUT)
    expected = np.linalg.lstsq(spline, parabolas @ keys.transl, rcond=None)[0]
    np.testing.assert_allclose(control_points(keys, LAYOUT).transl, expected, atol=1e-7)


def test_one_parabola_stays_the_same_curve() -> None:
    layout, prior = KeyframeLayout.even(41, 10), ToyPrior()
    keys = random_keys(layout.num_keys)
    t = layout.key_times[:, None] / 40.0
    keys = replace(keys, transl=np.concatenate([1.0 + t, t * t, 2.0 - t], axis=1))
    spline = key_poses(prior, control_points(keys, layout), layout, residuals=True, spline=True)
    np.testing.assert_allclose(spline.transl, key_poses(prior, keys, layout, residuals=True).transl, atol=1e-8)


def test_frames_are_nearer_to_the_solved_ones_than_those_of_the_solved_keys() -> None:
    keys, prior = random_keys(LAYOUT.num_keys), ToyPrior()
    solved = key_poses(prior, keys, LAYOUT, residuals=True)
    of_keys = key_poses(prior, keys, LAYOUT, residuals=True, spline=True)
    nearest = key_poses(prior, control_points(keys, LAYOUT), LAYOUT, residuals=True, spline=True)
    for name in ("root", "local", "transl"):
        far, near = (np.square(getattr(m, name) - getattr(solved, name)).sum() for m in (of_keys, nearest))
        assert near < 0.5 * far, name


def test_poses_are_on_their_manifolds_though_control_points_are_not() -> None:
    found = control_points(random_keys(LAYOUT.num_keys), LAYOUT)
    np.testing.assert_allclose(found.z.sum(axis=1), 0.0, atol=1e-9)
    poses = key_poses(ToyPrior(), found, LAYOUT, residuals=True, spline=True)
    eye = np.broadcast_to(np.eye(3), poses.root.shape)
    np.testing.assert_allclose(poses.root @ np.swapaxes(poses.root, -1, -2), eye, atol=1e-12)


def test_frames_stay_where_there_are_more_keys_than_frames() -> None:
    """Keys stand at half frames too where windows are one frame long: nothing is to be told of those."""
    layout, prior = KeyframeLayout(np.arange(6)), ToyPrior()
    keys = random_keys(layout.num_keys)
    spline = key_poses(prior, control_points(keys, layout), layout, residuals=True, spline=True)
    np.testing.assert_allclose(spline.transl, key_poses(prior, keys, layout, residuals=True).transl, atol=1e-6)
