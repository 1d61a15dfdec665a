"""Sides that a detector exchanges in one view are put back where the person is expected, if that is clear."""

from __future__ import annotations

import numpy as np
import pytest

from solver_backend.live.views_session import ExchangedSides
from solver_backend.types import JointSet

NAMES = JointSet.MEDIAPIPE_33.keypoints


@pytest.fixture
def expected() -> np.ndarray:
    """(33, 2) px of somebody 600 px tall with arms and legs apart."""
    rng = np.random.default_rng(3)
    places = rng.uniform((300, 100), (340, 700), (len(NAMES), 2))
    for row, name in enumerate(NAMES):
        places[row, 0] += {"left": 120.0, "right": -120.0}.get(name.partition("_")[0], 0.0)
    return places


def seen_of(expected: np.ndarray) -> np.ndarray:
    noise = np.random.default_rng(0).normal(0, 6.0, expected.shape)
    return np.concatenate([expected + noise, np.full((len(expected), 1), 0.9)], axis=1)


def exchange(seen: np.ndarray, parts: tuple[str, ...]) -> np.ndarray:
    rows = {name: row for row, name in enumerate(NAMES)}
    found = seen.copy()
    for part in parts:
        found[[rows[f"left_{part}"], rows[f"right_{part}"]]] = seen[[rows[f"right_{part}"], rows[f"left_{part}"]]]
    return found


ARMS = ("shoulder", "elbow", "wrist", "thumb", "index", "pinky")


def test_exchanged_arms_are_put_back_and_legs_stay(expected):
    seen = seen_of(expected)
    found, count = ExchangedSides(NAMES).put_back(exchange(seen, ARMS), expected)
    assert count == 1 and np.array_equal(found, seen)


def test_what_is_right_or_not_clear_stays(expected):
    sides, seen = ExchangedSides(NAMES), seen_of(expected)
    found, count = sides.put_back(seen, expected)
    assert count == 0 and np.array_equal(found, seen)
    crossed = expected.copy()
    rows = [row for row, name in enumerate(NAMES) if name.split("_")[-1] in ARMS]
    crossed[rows] = (320.0, 300.0) + np.random.default_rng(1).normal(0, 4.0, (len(rows), 2))  # arms that cross
    found, count = sides.put_back(exchange(seen_of(crossed), ARMS), crossed)
    assert count == 0
    missing = exchange(seen, ARMS)
    missing[:, 2] = 0.0
    found, count = sides.put_back(missing, expected)
    assert count == 0
