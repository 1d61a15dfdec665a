"""Screw motions between keys: through all of them, on arcs, whatever the axes of body and world; derivatives."""

from __future__ import annotations

import numpy as np
import pytest

from solver_backend.geometry.rotations import exp_so3, log_so3
from solver_backend.geometry.screw import ScrewPath

TIME = np.linspace(0.0, 1.0, 9)


def near_keys(count: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(4)
    first = exp_so3(rng.normal(size=3))
    return exp_so3(0.4 * rng.normal(size=(count, 3))) @ first, rng.normal(size=(count, 3))


@pytest.fixture
def keys() -> tuple[np.ndarray, np.ndarray]:
    return near_keys(3)


def through(rotation: np.ndarray, transl: np.ndarray) -> ScrewPath:
    """Return the path of one window."""
    return ScrewPath.through(rotation[None], transl[None], TIME[None])


def test_the_curve_meets_its_keys(keys):
    found = through(*keys)
    for frame, key in ((0, 0), (4, 1), (8, 2)):
        np.testing.assert_allclose(found.rotation[frame], keys[0][key], atol=1e-9)
        np.testing.assert_allclose(found.transl[frame], keys[1][key], atol=1e-9)


def test_windows_are_curves_of_their_own_through_as_many_keys_as_they_have():
    both = [near_keys(5), near_keys(5)]
    rotation, transl = (np.stack([both[0][part], both[1][part][::-1]]) for part in (0, 1))
    found = ScrewPath.through(rotation, transl, np.tile(TIME, (2, 1)))
    one = through(rotation[1], transl[1])
    np.testing.assert_allclose(found.transl[len(TIME) :], one.transl, atol=1e-12)
    np.testing.assert_allclose(found.by_keys[1], one.by_keys[0], atol=1e-12)
    steady = np.arange(4)[:, None] * np.array([0.1, 0.2, -0.1])
    met = through(exp_so3(steady) @ rotation[0, 0], 10 * steady)
    np.testing.assert_allclose(met.transl[[0, -1]], 10 * steady[[0, -1]], atol=1e-9)


def test_a_steady_screw_is_followed_on_its_helix():
    """Turning about an axis while rising along it: the middle is on the arc, not on the chord."""
    angle = np.array([0.0, 0.6, 1.2])
    rotation = exp_so3(angle[:, None] * np.array([0.0, 0.0, 1.0]))
    transl = np.stack([np.cos(angle), np.sin(angle), 0.1 * angle], axis=1)
    found = through(rotation, transl)
    angle = 1.2 * TIME
    np.testing.assert_allclose(found.transl, np.stack([np.cos(angle), np.sin(angle), 0.1 * angle], 1), atol=1e-9)
    np.testing.assert_allclose(log_so3(found.rotation), angle[:, None] * np.array([0.0, 0.0, 1.0]), atol=1e-9)


def test_without_turns_translations_are_on_the_parabola(keys):
    rotation = np.tile(keys[0][:1], (3, 1, 1))
    found = through(rotation, keys[1])
    a, b, c = keys[1]
    t = TIME[:, None]
    np.testing.assert_allclose(
        found.transl, (1 - t) * (1 - 2 * t) * a + 4 * t * (1 - t) * b + t * (2 * t - 1) * c, atol=1e-9
    )


def test_axes_of_body_and_world_have_no_say(keys):
    rotation, transl = keys
    plain = through(rotation, transl)
    world, shift, origin = exp_so3(np.array([0.3, -0.8, 0.5])), np.array([1.0, 2.0, -3.0]), np.array([0.2, 0.1, 0.9])
    moved = through(world @ rotation, (transl + rotation @ origin) @ world.T + shift)
    np.testing.assert_allclose(moved.rotation, world @ plain.rotation, atol=1e-9)
    np.testing.assert_allclose(moved.transl, (plain.transl + plain.rotation @ origin) @ world.T + shift, atol=1e-9)


@pytest.mark.parametrize("count", [2, 3, 4])
def test_the_product_with_a_cotangent_is_the_slope(count):
    rng = np.random.default_rng(9)
    rotation, transl = near_keys(count)
    found = through(rotation, transl)
    by_root, by_transl = rng.normal(size=(2, len(TIME), 3))
    by_turns, by_places = (part[0] for part in found.vjp(by_root, by_transl))

    def along(frames: ScrewPath) -> float:
        turn = log_so3(frames.rotation @ np.swapaxes(found.rotation, -1, -2))
        return float((by_root * turn).sum() + (by_transl * frames.transl).sum())

    h = 1e-6
    for turn, move in 2 * rng.normal(size=(3, 2, count, 3)):
        ends = [along(through(exp_so3(s * h * turn) @ rotation, transl + s * h * move)) for s in (1, -1)]
        expected = float((by_turns * turn).sum() + (by_places * move).sum())
        assert expected == pytest.approx((ends[0] - ends[1]) / (2 * h), rel=1e-6, abs=1e-6)


def test_torch_has_the_same_curve(keys):
    torch = pytest.importorskip("torch")
    plain = through(*keys)
    found = ScrewPath.through(*(torch.as_tensor(part[None]) for part in (*keys, TIME)))
    np.testing.assert_allclose(found.by_keys.numpy(), plain.by_keys, atol=1e-12)
