"""The blended curve: through its keys, one velocity where windows meet, a parabola where nothing is to be blended."""

from __future__ import annotations

import numpy as np
import pytest

from solver_backend.fitters.model.keyframe_curve import key_poses
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout
from solver_backend.fitters.model.keyframes import Keyframes
from solver_backend.fitters.model.spherical_mean import SphericalMean
from tests.support.random_keys import random_keys
from tests.support.toy_prior import ToyPrior

LAYOUT = KeyframeLayout(np.array([3, 13, 22, 33]))
"""Windows of 10, 9 and 11 frames: keys are not evenly spaced."""


def _at(times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return window, and the weights of all seven keys at these times."""
    window, time = LAYOUT.positions(times)
    shares = LAYOUT.blended_shares(window, time)
    whole = np.zeros((len(times), LAYOUT.num_keys + 2))
    for row, first, weights in zip(whole, 2 * window, shares, strict=True):
        row[first : first + 5] += weights
    assert np.abs(whole[:, [0, -1]]).max() < 1e-12
    return window, whole[:, 1:-1]


def test_it_passes_through_its_keys():
    np.testing.assert_allclose(_at(LAYOUT.key_times)[1], np.eye(LAYOUT.num_keys), atol=1e-12)


def test_it_keeps_parabolas():
    times = np.linspace(3, 33, 301)
    for power in range(3):
        np.testing.assert_allclose(_at(times)[1] @ LAYOUT.key_times**power, times**power, rtol=1e-9)


def test_velocities_agree_at_every_key_and_those_of_the_windows_own_parabolas_do_not():
    step, inner = 1e-6, LAYOUT.key_times[1:-1]
    before, at, after = (_at(inner + shift)[1] for shift in (-step, 0.0, step))
    np.testing.assert_allclose((after - at) / step, (at - before) / step, atol=1e-5)
    keys, prior = random_keys(LAYOUT.num_keys), ToyPrior()
    frames = np.array([12, 13, 14])

    def jump(blended: bool) -> float:
        return float(
            np.abs(np.diff(key_poses(prior, keys, LAYOUT, frames, residuals=True, blended=blended).transl, 2, 0)).max()
        )

    assert jump(True) < 0.75 * jump(False)


@pytest.mark.parametrize("residuals", [False, True])
def test_frames_at_the_keys_have_the_keys_poses(residuals):
    keys, prior = random_keys(LAYOUT.num_keys), ToyPrior()
    frames = np.array([3, 8, 13, 22, 33])
    one, other = (key_poses(prior, keys, LAYOUT, frames, residuals=residuals, blended=b) for b in (True, False))
    for name in ("root", "local", "transl"):
        np.testing.assert_allclose(getattr(one, name), getattr(other, name), atol=1e-9)


def test_a_window_alone_is_its_parabola():
    alone = KeyframeLayout(np.array([0, 8]))
    window, time = alone.positions(np.arange(9))
    shares = alone.blended_shares(window, time)
    np.testing.assert_allclose(shares[:, 1:4] @ np.array([0.0, 4.0, 8.0]) ** 2, np.arange(9.0) ** 2, atol=1e-12)
    assert np.abs(shares[:, [0, 4]]).max() < 1e-12


def test_codes_stay_on_their_sphere_and_carry_derivatives_back():
    rng = np.random.default_rng(3)
    keys = Keyframes.triples(random_keys(7), np.arange(2))
    weights, cotangent = rng.normal(1.0, 0.3, (2, 4, 3)), rng.normal(size=(2, 4, 32))
    mean = SphericalMean.of(keys.z, weights)
    np.testing.assert_allclose(np.linalg.norm(mean.value, axis=-1), 1.0)
    np.testing.assert_allclose(mean.value.sum(-1), 0.0, atol=1e-12)
    direction = 1e-6 * rng.normal(size=keys.z.shape)
    up, down = (SphericalMean.of(keys.z + sign * direction, weights).value for sign in (1, -1))
    numeric = 0.5 * np.sum((up - down) * cotangent)
    np.testing.assert_allclose(np.sum(mean.vjp(cotangent).sum(axis=1) * direction), numeric, rtol=1e-5)
