"""Hands from markers: a known motion comes back with many and with few, and real exercises within the criterion."""

from __future__ import annotations

import numpy as np
import pytest

from solver_backend.body.hand_markers import PLACES, hand_markers
from solver_backend.body.hand_skeleton import FINGER_OF, JOINT_OF, KIND_OF, HandSites, HandSkeleton
from solver_backend.fitters.hands.solve_hand import HandProblem
from solver_backend.priors.hand_prior import load_hand_prior
from solver_backend.residuals.positions import PositionTerm
from tests.support.lone_marker_hand import LAYOUTS, solve_marker_hand
from tests.support.moving_hand import FPS, drawn_states, wrist_path
from tests.support.open_hand import open_hand

FLEXIONS = np.flatnonzero((FINGER_OF > 0) & (KIND_OF == 0) & (JOINT_OF < 2))
FRAMES = 90


def worn(labels: tuple[str, ...], side: int = 1, size: float = 1.1) -> tuple[np.ndarray, np.ndarray]:
    """Return (F, L, 3) markers of a larger hand, worn 3 mm off their places, and the true (F, D) states."""
    skeleton, rng = HandSkeleton.of_points(open_hand(side), side).scaled(size), np.random.default_rng(8)
    rule = hand_markers(skeleton, labels).sites
    sites = HandSites(rule.finger, rule.segment, rule.offset + rng.normal(0, 0.003, rule.offset.shape))
    states, path = drawn_states(FRAMES, 8), wrist_path(FRAMES, 8)
    term = PositionTerm(np.zeros((FRAMES, len(labels), 3)), np.zeros((FRAMES, len(labels))))
    problem = HandProblem(skeleton, sites, path, term, load_hand_prior(), FPS)
    return problem.points(states) + rng.normal(0, 0.0005, (FRAMES, len(labels), 3)), states


@pytest.mark.parametrize(("layout", "largest_deg"), [("hand26", 5.0), ("hand10", 9.0)])
@pytest.mark.parametrize("side", [0, 1])
def test_a_known_motion_comes_back(layout: str, largest_deg: float, side: int) -> None:
    labels = LAYOUTS[layout]
    positions, states = worn(labels, side)
    found = solve_marker_hand(positions, labels, HandSkeleton.of_points(open_hand(side), side), FPS)
    error = np.rad2deg(found.angles - states[:, 6:])[:, FLEXIONS]
    assert np.sqrt((error**2).mean()) < largest_deg
    left = np.linalg.norm(found.problem.points(found.states) - positions, axis=-1)
    assert np.median(left) < 0.003


def test_markers_that_are_missing_for_a_while_are_ridden_out() -> None:
    labels = LAYOUTS["hand26"]
    positions, states = worn(labels)
    positions[30:50, labels.index("PP3")] = np.nan
    positions[20:26] = np.nan
    found = solve_marker_hand(positions, labels, HandSkeleton.of_points(open_hand(1), 1), FPS)
    error = np.rad2deg(found.angles - states[:, 6:])[:, FLEXIONS]
    assert np.sqrt((error[26:] ** 2).mean()) < 6.0
    assert np.isfinite(found.states).all()


def test_every_layout_is_of_known_markers_and_others_are_left_out() -> None:
    skeleton = HandSkeleton.of_points(open_hand(1), 1)
    for labels in LAYOUTS.values():
        assert set(labels) <= set(PLACES)
        assert hand_markers(skeleton, (*labels, "LASI")).labels == labels
