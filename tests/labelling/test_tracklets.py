"""Tracks are cut where they jump, and joined where one goes on from another."""

from __future__ import annotations

import numpy as np

from solver_backend.labelling.tracklets import tracklets_of

FPS = 100.0


def paths(frames: int = 200, markers: int = 6) -> np.ndarray:
    t = np.arange(frames)[:, None, None] / FPS
    start = np.random.default_rng(0).uniform(-0.6, 0.6, (1, markers, 3))
    return start + 0.2 * np.sin(2.0 * t + np.arange(markers)[:, None] + np.arange(3))


def test_whole_tracks_are_one_stretch_each():
    found = tracklets_of(paths(), FPS)
    assert len(found) == found.num_chains == 6
    assert np.array_equal(found.first, np.zeros(6)) and np.array_equal(found.last, np.full(6, 199))


def test_a_track_that_goes_on_in_another_column_is_one_chain():
    points = np.full((200, 7, 3), np.nan)
    points[:, :6] = paths()
    points[120:, 6], points[120:, 2] = points[120:, 2], np.nan
    found = tracklets_of(points, FPS)
    assert len(found) == 7 and found.num_chains == 6
    mine = found.chain[[np.flatnonzero(found.column == c)[0] for c in (2, 6)]]
    assert mine[0] == mine[1]


def test_a_swap_of_two_far_tracks_cuts_both_and_joins_them_crosswise():
    points = paths()
    points[80:, [0, 1]] = points[80:, [1, 0]]
    found = tracklets_of(points, FPS)
    chain_of = lambda column, frame: found.chain[found.number[frame, column]]  # noqa: E731
    assert chain_of(0, 40) == chain_of(1, 150) != chain_of(0, 150)
    assert chain_of(1, 40) == chain_of(0, 150)


def test_a_short_gap_is_bridged_and_a_long_one_is_not():
    points = paths()
    points[50:55, 0] = np.nan
    points[50:110, 1] = np.nan
    found = tracklets_of(points, FPS)
    assert (found.column == 0).sum() == 1 and (found.column == 1).sum() == 2
    assert found.number[52, 0] == -1


def test_no_points_make_no_stretches():
    assert len(tracklets_of(np.full((5, 3, 3), np.nan), FPS)) == 0
