"""No marker twice, and the sum of the evidence as large as it can be."""

from __future__ import annotations

from itertools import permutations

import numpy as np

from solver_backend.labelling.outputs import GHOST
from solver_backend.labelling.tracklets import labels_of_frame, labels_of_stretches


def evidence(count: int, seed: int) -> np.ndarray:
    return np.log(np.random.default_rng(seed).dirichlet(np.full(GHOST + 1, 0.05), count) + 1e-4)


def test_no_marker_is_given_to_two_points_of_a_frame():
    for seed in range(5):
        labels = labels_of_frame(np.repeat(evidence(20, seed), 3, axis=0))
        markers = labels[labels < GHOST]
        assert len(set(markers.tolist())) == len(markers)


def test_a_clear_frame_is_told_as_it_is():
    truth = np.random.default_rng(0).permutation(GHOST)[:40]
    scores = np.full((40, GHOST + 1), -6.0)
    scores[np.arange(40), truth] = -0.1
    assert np.array_equal(labels_of_frame(scores), truth)


def test_the_surer_of_two_points_has_the_marker():
    scores = np.full((2, GHOST + 1), -9.0)
    scores[:, 7], scores[0, GHOST], scores[1, GHOST] = -0.5, -3.0, -1.0
    assert labels_of_frame(scores).tolist() == [7, GHOST]


def test_stretches_seen_together_are_different_markers_and_others_may_be_the_same():
    scores = np.full((3, GHOST + 1), -9.0)
    scores[:, 4] = -0.1
    together = np.zeros((3, 3), dtype=bool)
    together[0, 1] = together[1, 0] = True
    labels = labels_of_stretches(scores, together)
    assert labels[2] == 4 and sorted((labels[:2] == 4).tolist()) == [False, True]


def test_few_stretches_get_the_best_of_all_assignments():
    rng = np.random.default_rng(2)
    for _ in range(20):
        scores = np.full((4, GHOST + 1), -50.0)
        scores[:, :4] = rng.normal(size=(4, 4))
        together = ~np.eye(4, dtype=bool)
        labels = labels_of_stretches(scores, together)
        found = scores[np.arange(4), labels].sum()
        best = max(scores[np.arange(4), list(order)].sum() for order in permutations(range(4)))
        assert found >= best - 0.6  # greedy and exchanges: near the best, and nearly always it


def test_what_a_person_told_binds():
    scores = np.full((2, GHOST + 1), -9.0)
    scores[:, 4] = -0.1
    scores[:, 5] = -1.0
    together = ~np.eye(2, dtype=bool)
    assert labels_of_stretches(scores, together, {1: 4}).tolist() == [5, 4]
    assert labels_of_stretches(scores, together, {1: GHOST}).tolist() == [4, GHOST]
