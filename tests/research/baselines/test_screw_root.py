"""Screw motions between keys: through all of them, on arcs, whatever the axes of body and world; derivatives."""

from __future__ import annotations

import numpy as np
import pytest

from research.baselines.screw_root import ScrewRoot
from solver_backend.geometry.rotations import exp_so3, log_so3

TIME = np.linspace(0.0, 1.0, 9)


@pytest.fixture
def keys() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(4)
    first = exp_so3(rng.normal(size=3))
    return exp_so3(0.4 * rng.normal(size=(3, 3))) @ first, rng.normal(size=(3, 3))


def test_the_curve_meets_its_keys(keys):
    found = ScrewRoot.through(*keys, TIME)
    for frame, key in ((0, 0), (4, 1), (8, 2)):
        np.testing.assert_allclose(found.rotation[frame], keys[0][key], atol=1e-9)
        np.testing.assert_allclose(found.transl[frame], keys[1][key], atol=1e-9)


def test_a_steady_screw_is_followed_on_its_helix():
    """Turning about an axis while rising along it: the middle is on the arc, not on the chord."""
    angle = np.array([0.0, 0.6, 1.2])
    rotation = exp_so3(angle[:, None] * np.array([0.0, 0.0, 1.0]))
    transl = np.stack([np.cos(angle), np.sin(angle), 0.1 * angle], axis=1)
    found = ScrewRoot.through(rotation, transl, TIME)
    angle = 1.2 * TIME
    np.testing.assert_allclose(found.transl, np.stack([np.cos(angle), np.sin(angle), 0.1 * angle], 1), atol=1e-9)
    np.testing.assert_allclose(log_so3(found.rotation), angle[:, None] * np.array([0.0, 0.0, 1.0]), atol=1e-9)


def test_without_turns_translations_are_on_the_parabola(keys):
    rotation = np.tile(keys[0][:1], (3, 1, 1))
    found = ScrewRoot.through(rotation, keys[1], TIME)
    a, b, c = keys[1]
    t = TIME[:, None]
    np.testing.assert_allclose(
        found.transl, (1 - t) * (1 - 2 * t) * a + 4 * t * (1 - t) * b + t * (2 * t - 1) * c, atol=1e-9
    )


def test_axes_of_body_and_world_have_no_say(keys):
    rotation, transl = keys
    plain = ScrewRoot.through(rotation, transl, TIME)
    world, shift, origin = exp_so3(np.array([0.3, -0.8, 0.5])), np.array([1.0, 2.0, -3.0]), np.array([0.2, 0.1, 0.9])
    moved = ScrewRoot.through(world @ rotation, (transl + rotation @ origin) @ world.T + shift, TIME)
    np.testing.assert_allclose(moved.rotation, world @ plain.rotation, atol=1e-9)
    np.testing.assert_allclose(moved.transl, (plain.transl + plain.rotation @ origin) @ world.T + shift, atol=1e-9)


def test_the_product_with_a_cotangent_is_the_slope(keys):
    rng = np.random.default_rng(9)
    rotation, transl = keys
    found = ScrewRoot.through(rotation, transl, TIME)
    by_root, by_transl = rng.normal(size=(2, len(TIME), 3))
    by_turns, by_places = found.vjp(by_root, by_transl)

    def along(frames: ScrewRoot) -> float:
        turn = log_so3(frames.rotation @ np.swapaxes(found.rotation, -1, -2))
        return float((by_root * turn).sum() + (by_transl * frames.transl).sum())

    h = 1e-6
    for key in range(3):
        for axis in range(3):
            d = np.zeros((3, 3))
            d[key, axis] = h
            turned = [along(ScrewRoot.through(exp_so3(s * d) @ rotation, transl, TIME)) for s in (1, -1)]
            moved = [along(ScrewRoot.through(rotation, transl + s * d, TIME)) for s in (1, -1)]
            assert by_turns[key, axis] == pytest.approx((turned[0] - turned[1]) / (2 * h), rel=1e-6, abs=1e-7)
            assert by_places[key, axis] == pytest.approx((moved[0] - moved[1]) / (2 * h), rel=1e-6, abs=1e-7)
