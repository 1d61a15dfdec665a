"""Keys of the blended curve: nearest to the parabolas of all, where they are one parabola the same, at any length."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver_backend.fitters.model.blended_keys import blended_keys
from solver_backend.fitters.model.keyframe_curve import key_poses, lagrange
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout
from tests.support.random_keys import random_keys
from tests.support.toy_prior import ToyPrior

LAYOUT = KeyframeLayout(np.array([3, 13, 22, 33, 43]))


def _weights(layout: KeyframeLayout) -> tuple[np.ndarray, np.ndarray]:
    """Return dense (F, K) weights of the blended curve and of the parabolas."""
    frames, rows = layout.frames, np.arange(len(layout.frames))
    window, time = layout.positions(frames)
    blended, parabolas = np.zeros((len(frames), layout.num_keys + 2)), np.zeros((len(frames), layout.num_keys))
    for k in range(5):
        blended[rows, 2 * window + k] += layout.blended_shares(window, time)[:, k]
    for k in range(3):
        parabolas[rows, 2 * window + k] += lagrange(time)[:, k]
    return blended[:, 1:-1], parabolas


def test_they_are_the_least_squares_solution() -> None:
    keys, (blended, parabolas) = random_keys(LAYOUT.num_keys), _weights(LAYOUT)
    expected = np.linalg.lstsq(blended, parabolas @ keys.transl, rcond=None)[0]
    np.testing.assert_allclose(blended_keys(keys, LAYOUT).transl, expected, atol=1e-8)


def test_one_parabola_stays() -> None:
    keys = random_keys(LAYOUT.num_keys)
    t = LAYOUT.key_times[:, None] / 40.0
    keys = replace(keys, transl=np.concatenate([1.0 + t, t * t, 2.0 - t], axis=1))
    np.testing.assert_allclose(blended_keys(keys, LAYOUT).transl, keys.transl, atol=1e-8)


def test_frames_are_nearer_to_the_solved_ones_than_through_the_solved_keys() -> None:
    keys, prior = random_keys(LAYOUT.num_keys), ToyPrior()
    solved = key_poses(prior, keys, LAYOUT, residuals=True)
    through = key_poses(prior, keys, LAYOUT, residuals=True, blended=True)
    nearest = key_poses(prior, blended_keys(keys, LAYOUT), LAYOUT, residuals=True, blended=True)
    for name in ("root", "local", "transl"):
        far, near = (np.square(getattr(m, name) - getattr(solved, name)).sum() for m in (through, nearest))
        assert near < 0.8 * far, name


def test_codes_and_quaternions_stay_on_their_spheres() -> None:
    found = blended_keys(random_keys(LAYOUT.num_keys), LAYOUT)
    np.testing.assert_allclose(np.linalg.norm(found.quat, axis=1), 1.0)
    np.testing.assert_allclose(np.linalg.norm(found.z, axis=1), 1.0)
    np.testing.assert_allclose(found.z.sum(axis=1), 0.0, atol=1e-12)


def test_keys_that_no_frame_tells_stay() -> None:
    """Keys stand at half frames too where windows are one frame long: nothing is to be told of those."""
    layout = KeyframeLayout(np.arange(6))
    keys = random_keys(layout.num_keys)
    found = blended_keys(keys, layout)
    np.testing.assert_allclose(found.transl, keys.transl, atol=1e-8)
