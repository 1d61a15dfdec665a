"""What a body says of labels: of limbs that it fits, and of none whose own markers it is far from."""

from __future__ import annotations

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.body.landmarks import pose_landmarks
from solver_backend.body.markers import marker_landmarks, marker_layout
from solver_backend.fitters.recipes.live import fit_average_person
from solver_backend.labelling.label_take import GHOST_M, Votes, body_evidence
from solver_backend.labelling.outputs import GHOST, MARKERS
from solver_backend.labelling.tracklets import tracklets_of

FPS, FRAMES = 60.0, 61
CMU_41 = [MARKERS.index(name) for name in marker_layout("CMU_41")]


@pytest.fixture(scope="module")
def standing() -> np.ndarray:
    """(53, 3) markers of a person who stands, arms lowered by 60 degrees."""
    body, local = load_body(), np.broadcast_to(np.eye(3), (1, 21, 3, 3)).copy()
    for joint, sign in ((15, -1.0), (16, 1.0)):
        c, s = np.cos(np.pi / 3), np.sin(np.pi / 3) * sign
        local[0, joint] = [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]
    landmarks = marker_landmarks(body, MARKERS)
    root = np.array([[[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]])  # Y up to Z up
    return pose_landmarks(body, landmarks, np.zeros(10), root, local, np.zeros((1, 3))).points[0]


def evidence(markers: np.ndarray, unsure: int) -> np.ndarray:
    """Return (54,) what the body says of one point, laid over the other 40 of CMU's markers."""
    positions = np.broadcast_to(markers[CMU_41], (FRAMES, len(CMU_41), 3))
    trusted = np.array([label != unsure for label in CMU_41])
    frames = np.arange(0, FRAMES, 2)
    landmarks = np.broadcast_to(markers, (len(frames), *markers.shape))
    nothing = np.zeros((len(CMU_41), GHOST + 1))
    covariance = np.broadcast_to(0.1**2 * np.eye(3), (*landmarks.shape, 3))
    votes = Votes(frames, landmarks, covariance, nothing, nothing, nothing[:, 0])
    tracklets = tracklets_of(positions, FPS)
    found = body_evidence(positions, tracklets, votes, np.array(CMU_41), trusted, FPS, fit_average_person())
    return found[CMU_41.index(unsure)]


def test_a_point_that_is_in_its_place_is_told_by_the_body(standing):
    finger = MARKERS.index("LFIN")
    said = evidence(standing, finger)
    assert said.argmax() == finger
    assert said[finger] > said[GHOST] + 2.0


def test_a_wrist_with_a_bar_says_nothing_of_the_hand(standing):
    """Both ends of a bar of 25 cm are off this body's wrist: what it says of that hand is no more than of none."""
    left, right = ([MARKERS.index(side + name) for name in ("WRA", "WRB", "FIN")] for side in "LR")
    barred = standing.copy()
    along = barred[left[0]] - barred[left[1]]
    along = along / np.linalg.norm(along)
    middle = barred[left[:2]].mean(axis=0)
    barred[left[0]], barred[left[1]] = middle + 0.125 * along, middle - 0.125 * along
    said = evidence(barred, left[2])
    assert said[left] == pytest.approx(said[GHOST], abs=1e-9)
    assert evidence(barred, right[2]).argmax() == right[2]
    assert np.linalg.norm(barred[left[0]] - standing[left[0]]) < GHOST_M
