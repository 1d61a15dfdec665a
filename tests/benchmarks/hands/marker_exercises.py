"""Recorded finger exercises of real hands, solved from many and from few markers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from solver_backend.body.hand_markers import PLACES, hand_markers
from solver_backend.body.hand_skeleton import FINGER_OF, JOINT_OF, KIND_OF, measure_angles
from solver_backend.body.hands import hand_skeletons, load_body_with_hands
from solver_backend.fitters.hands.marker_hand import MarkerHand
from tests.support.lone_marker_hand import LAYOUTS, solve_marker_hand
from training.hands.train import marker_points

RIGHT, STRIDE = 1, 3  # All are right hands. 150 Hz is more than fingers need.
FLEXIONS = np.flatnonzero((FINGER_OF > 0) & (KIND_OF == 0) & (JOINT_OF < 2))
UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Rotation from y up to z up."""


def exercise_errors(path: Path, layout: str) -> tuple[np.ndarray, np.ndarray]:
    """Return (F, 8) flexion errors in degrees, of the solved hand's markers and of its joints.

    The first errors compare angles of markers on the back of the hand with each other. The second errors include the
    constant difference between such angles and those of the joints below.

    Args:
        path: exercise with 26 markers.
        layout: layout of the markers that the solve uses.
    """
    arrays = dict(np.load(path).items())
    labels = tuple(str(name) for name in arrays["labels"])
    recorded = arrays["positions_01mm"][::STRIDE].astype(np.float64)
    recorded = np.where(recorded == np.iinfo(np.int16).min, np.nan, recorded) * 1e-4 @ UP.T
    truth = measure_angles(marker_points(arrays)[::STRIDE], RIGHT)[:, FLEXIONS]
    given = LAYOUTS[layout]
    skeleton = hand_skeletons(load_body_with_hands())[RIGHT]
    hand = solve_marker_hand(
        recorded[:, [labels.index(label) for label in given]], given, skeleton, float(arrays["rate"]) / STRIDE
    )
    carried = recorded.copy()
    places = tuple(PLACES)
    carried[:, [labels.index(label) for label in places]] = _carried(hand, places)
    grid = np.where(np.isnan(carried), -3.2768, carried) * 1e4
    points = marker_points({**arrays, "positions_01mm": grid})
    alike = np.rad2deg(measure_angles(points, RIGHT)[:, FLEXIONS] - truth)
    return alike, np.rad2deg(hand.angles[:, FLEXIONS] - truth)


def _carried(hand: MarkerHand, labels: tuple[str, ...]) -> np.ndarray:
    """Return (F, L, 3) positions of all markers on a solved hand, calibrated if given, otherwise by their rule."""
    every = hand_markers(hand.problem.skeleton, labels)
    offset = every.sites.offset.copy()
    for row, label in enumerate(every.labels):
        if label in hand.markers.labels:
            offset[row] = hand.markers.sites.offset[hand.markers.labels.index(label)]
    return hand.problem.at(replace(every.sites, offset=offset)).points(hand.states)
