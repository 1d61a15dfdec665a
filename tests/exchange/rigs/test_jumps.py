"""Leaps of a figure away and back are interpolated; a fast or cut motion stays as it is."""

from __future__ import annotations

import numpy as np
import pytest

from solver_backend.exchange.rigs.jumps import bridge_jumps

FPS = 30.0


def bridged(ways: np.ndarray) -> tuple[np.ndarray, list[tuple[str, tuple[tuple[int, int], ...], float]]]:
    """Return ways along x after bridging, and the diagnostics' action, frames and speed."""
    joints = np.zeros((len(ways), 1, 3))
    joints[:, 0, 0] = ways
    turns = np.tile(np.eye(3), (len(ways), 1, 1, 1))
    done, _, found = bridge_jumps(joints, turns, 0, FPS)
    return done[:, 0, 0], [(item.values["done"], item.where.frames, item.values["size"]) for item in found]


FRAMES = np.arange(90.0)
STILL = np.zeros(60)


@pytest.mark.parametrize(
    "ways",
    [
        pytest.param(25.0 / FPS * FRAMES, id="a skier"),
        pytest.param(0.5 * 20.0 * (FRAMES / FPS) ** 2, id="a figure that accelerates"),
        pytest.param(np.concatenate([STILL, 25.0 / FPS * np.arange(6), STILL + 25.0 / FPS * 6]), id="a short dash"),
        pytest.param(np.arange(6.0), id="poses side by side"),
        pytest.param(np.concatenate([[0.0], 5.0 + STILL]), id="a T-pose before the motion"),
        pytest.param(np.concatenate([STILL, [5.0]]), id="a loop that snaps back"),
        pytest.param(np.concatenate([STILL, 5.0 + np.zeros(4)]), id="a short tail after a cut"),
    ],
)
def test_motion_that_does_not_come_back_is_kept(ways: np.ndarray) -> None:
    done, found = bridged(ways)
    np.testing.assert_array_equal(done, ways)
    assert [action for action, *_ in found] == ["kept"]


def test_a_leap_and_a_cut_have_their_own_speeds() -> None:
    ways = np.concatenate([STILL, [50.0, 50.0], STILL, 5.0 + STILL])
    done, found = bridged(ways)
    np.testing.assert_allclose(done, np.where(ways == 50.0, 0.0, ways), atol=1e-12)
    (leap, there, fast), (cut, at, slower) = found
    assert (leap, there, cut, at) == ("interpolated", ((60, 61),), "kept", ((121, 122),))
    assert (fast, slower) == pytest.approx((1500.0, 150.0))
