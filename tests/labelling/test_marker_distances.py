"""Distances over a take tell markers apart that look alike in a frame."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.body.landmarks import pose_landmarks
from solver_backend.body.markers import marker_landmarks
from solver_backend.exchange.errors import WeightsInvalid
from solver_backend.geometry.rotations import exp_so3
from solver_backend.labelling import tracklets
from solver_backend.labelling.outputs import GHOST, MARKERS
from solver_backend.labelling.tracklets import (
    NAME,
    DistanceTable,
    distance_evidence,
    distances_of,
    load_distances,
    tracklets_of,
)
from solver_backend.priors.weights import PriorWeights, write_weights

FPS = 30.0


@pytest.fixture(scope="module")
def table() -> DistanceTable:
    return load_distances()


@pytest.fixture(scope="module")
def moving() -> np.ndarray:
    """(F, 53, 3) markers of a small body that bends knees, elbows and wrists."""
    body, t = load_body(), np.arange(150) / FPS
    local = np.zeros((len(t), 21, 3))
    for joint, rate in ((3, 2.0), (4, 2.5), (17, 3.0), (18, 3.5), (19, 5.0), (20, 4.0)):
        local[:, joint, joint % 3] = 0.6 * np.sin(rate * t)
    root = np.broadcast_to(exp_so3(np.array([np.pi / 2, 0, 0])), (len(t), 3, 3))
    points = pose_landmarks(
        body, marker_landmarks(body, MARKERS), np.zeros(10), root, exp_so3(local), np.zeros((len(t), 3))
    ).points
    return 0.9 * points


def test_distances_are_means_and_deviations_of_what_is_seen_together(moving):
    points = moving[:, :3].copy()
    points[100:, 2] = np.nan
    tracks = tracklets_of(points, FPS)
    found = distances_of(points, np.arange(0, 150, 3), tracks, FPS)
    apart = np.linalg.norm(points[0:150:3, 0] - points[0:150:3, 2], axis=-1)
    row, column = (tracks.chain[tracks.column == c][0] for c in (0, 2))
    assert found.mean[row, column] == pytest.approx(np.nanmean(apart))
    assert found.change[row, column] == pytest.approx(np.nanstd(apart), abs=1e-6)
    assert found.seconds[row, column] == pytest.approx(3.4)
    assert np.allclose(found.mean, found.mean.T)


# Of the two sides of a wrist, a knee or an ankle distances tell little: they know no mirror image from the other.
@pytest.mark.parametrize("name", ["LFIN", "LFRM", "C7", "LTOE", "RBHD", "LSHN", "LUPA"])
def test_one_marker_that_nobody_named_is_told_by_the_others(moving, table, name):
    mine = MARKERS.index(name)
    tracks = tracklets_of(moving, FPS)
    labels = np.arange(len(MARKERS))[tracks.column]
    trusted = labels != mine
    evidence = distance_evidence(distances_of(moving, np.arange(0, 150, 2), tracks, FPS), labels, trusted, table)
    row = int(np.flatnonzero(labels == mine)[0])
    assert evidence[row].argmax() == mine
    assert evidence[row, mine] > evidence[row, MARKERS.index("RHEE" if name != "RHEE" else "C7")] + 5.0


def test_a_point_on_a_chair_beside_the_person_is_none_of_them(moving, table):
    chair = np.broadcast_to(moving.mean((0, 1)) + (1.2, 0.3, 0.0), (150, 1, 3))
    points = np.concatenate([moving, chair], axis=1)
    tracks = tracklets_of(points, FPS)
    labels = np.append(np.arange(len(MARKERS)), GHOST)[tracks.column]
    found = distances_of(points, np.arange(0, 150, 2), tracks, FPS)
    evidence = distance_evidence(found, labels, labels != GHOST, table)
    assert (evidence[labels == GHOST].argmax(1) == GHOST).all()


def test_columns_that_are_empty_for_now_and_parts_change_no_figure(moving, table, monkeypatch):
    frames = np.arange(0, 150, 2)
    tracks = tracklets_of(moving, FPS)
    labels = np.arange(len(MARKERS))[tracks.column]
    found = distances_of(moving, frames, tracks, FPS)
    late = np.concatenate([moving, np.full((150, 300, 3), np.nan)], axis=1)
    late[-20:, 53:55] = 1.0
    again = distances_of(late, frames, tracklets_of(late, FPS), FPS)
    for before, after in zip(vars(found).values(), vars(again).values(), strict=True):
        np.testing.assert_allclose(after[:53, :53], before, atol=1e-6)
    whole = distance_evidence(found, labels, labels != 5, table)
    monkeypatch.setattr(tracklets, "_CELLS", 20_000)
    assert distance_evidence(found, labels, labels != 5, table).tobytes() == whole.tobytes()


def test_stretches_that_are_never_seen_together_weigh_nothing_in_parts_either(moving, table, monkeypatch):
    pieces = np.full((150, 3 * 53, 3), np.nan)
    for k in range(3):
        pieces[50 * k : 50 * k + 35, 53 * k : 53 * (k + 1)] = moving[50 * k : 50 * k + 35]
    pieces = np.concatenate([pieces, np.full((150, 1, 3), np.nan)], axis=1)
    pieces[142:, -1] = 1.0  # beside nobody
    tracks = tracklets_of(pieces, FPS)
    labels = (np.append(np.tile(np.arange(53), 3), GHOST))[tracks.column]
    found = distances_of(pieces, np.arange(0, 150, 2), tracks, FPS)
    whole = distance_evidence(found, labels, labels != 5, table)
    monkeypatch.setattr(tracklets, "_CELLS", 200_000)
    np.testing.assert_allclose(distance_evidence(found, labels, labels != 5, table), whole, rtol=1e-12, atol=1e-12)


def test_two_that_exchange_their_labels_keep_their_distance(moving, table):
    a, b = MARKERS.index("LWRB"), MARKERS.index("LFIN")
    tracks = tracklets_of(moving, FPS)
    truth = np.arange(len(MARKERS))[tracks.column]
    labels = truth.copy()
    labels[truth == a], labels[truth == b] = b, a
    found = distances_of(moving, np.arange(0, 150, 2), tracks, FPS)
    evidence = distance_evidence(found, labels, np.ones(len(labels), bool), table)
    rows = np.arange(len(labels))
    now, then = evidence[rows, labels].sum(), evidence[rows, truth].sum()
    assert then > now


def test_the_other_side_tells_how_a_person_is_marked(moving, table):
    points = moving.copy()
    for side in "LR":  # a bar at each wrist, whose ends stand out, and one of them beyond the hand's marker
        a, b, hand = (MARKERS.index(side + name) for name in ("WRA", "WRB", "FIN"))
        across = points[:, b] - points[:, a]
        across *= 0.03 / np.linalg.norm(across, axis=-1, keepdims=True)
        points[:, b] += across + 1.2 * (points[:, hand] - points[:, b])
        points[:, a] -= across
    tracks = tracklets_of(points, FPS)
    truth = np.arange(len(MARKERS))[tracks.column]
    labels, left, right = truth.copy(), ("LWRB", "LFIN"), ("RWRB", "RFIN")
    labels[[int(np.flatnonzero(truth == MARKERS.index(name))[0]) for name in left]] = [
        MARKERS.index(name) for name in reversed(left)
    ]
    found = distances_of(points, np.arange(0, 150, 2), tracks, FPS)

    def gain(trusted: np.ndarray) -> float:
        evidence = distance_evidence(found, labels, trusted, table)
        rows = np.arange(len(labels))
        return evidence[rows, truth].sum() - evidence[rows, labels].sum()

    assert gain(np.ones(len(labels), bool)) > 1.0
    assert gain(~np.isin(truth, [MARKERS.index(name) for name in right])) < 0.0


def test_too_few_partners_say_nothing(moving, table):
    tracks = tracklets_of(moving, FPS)
    found = distances_of(moving, np.arange(0, 150, 10), tracks, FPS)
    trusted = np.zeros(tracks.num_chains, bool)
    trusted[:3] = True
    labels = np.zeros(tracks.num_chains, dtype=int)
    assert not distance_evidence(found, labels, trusted, table).any()


def test_a_table_of_other_places_is_refused(tmp_path):
    arrays = {name: np.zeros(10) for name in ("mean", "spread", "change", "change_spread")}
    write_weights(tmp_path / f"{NAME}.npz", PriorWeights(NAME, arrays, {}))
    with pytest.raises(WeightsInvalid, match="other marker positions"):
        load_distances(tmp_path / f"{NAME}.npz")


def test_a_thousand_points_are_compared_a_few_frames_at_a_time() -> None:
    rng = np.random.default_rng(0)
    points = np.repeat(rng.uniform(-3, 3, (1, 1000, 3)), 20, axis=0)
    tracks = tracklets_of(points, FPS)
    tracemalloc.start()
    found = distances_of(points, np.arange(20), tracks, FPS)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 200e6
    order = tracks.column[np.argsort(tracks.chain)]
    assert np.allclose(found.mean, np.linalg.norm(points[0][order][:, None] - points[0][order], axis=-1), atol=1e-6)
