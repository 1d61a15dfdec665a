"""Wrong labels, ghosts and markers that stand still: found where they are, and of no weight in the solve."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solver_backend.body.markers import marker_layout
from solver_backend.exchange.diagnostics import diagnostic, read_diagnostics, sentence
from solver_backend.fitters import Solution, solve
from solver_backend.fitters.marker_calibration.label_faults import clean_labels, gathered
from solver_backend.geometry.marker_jumps import frozen, jumping, leaving, neighbours_of
from solver_backend.types import MARKER_FILLED, MARKER_GHOST, MARKER_SEEN, MARKER_SWAPPED, Capture
from tests.support.worn_markers import worn_markers

pytestmark = pytest.mark.slow  # Making what these tests look at takes 4 to 14 seconds of CPU time.

LABELS = marker_layout("PLUGIN_GAIT_39")
FPS, FRAMES = 60.0, 90
SWAP, GHOST, STILL = slice(20, 32), slice(50, 58), slice(40, 90)
WRISTS = [LABELS.index("LWRA"), LABELS.index("LWRB")]
KNEE, TOE = LABELS.index("RKNE"), LABELS.index("LELB")


@pytest.fixture(scope="module")
def worn():
    return worn_markers(LABELS, FRAMES, fps=FPS)


@pytest.fixture(scope="module")
def spoilt(worn) -> np.ndarray:
    points = worn.cloud.positions.copy()
    points[SWAP, WRISTS] = points[SWAP, WRISTS[::-1]]
    points[GHOST, KNEE] += (0.0, 0.25, 0.1)
    points[STILL, TOE] = points[STILL.start, TOE]
    return points


@pytest.fixture(scope="module")
def solution(worn, spoilt) -> Solution:
    return solve(Capture("take", markers=replace(worn.cloud, positions=spoilt)))


def test_a_clean_take_is_not_tested(worn):
    points = worn.cloud.positions
    around = neighbours_of(points)
    assert not jumping(points, around).any() and not frozen(points, around, FPS).any()


def test_what_jumps_is_found(spoilt):
    around = neighbours_of(spoilt)
    jumps = jumping(spoilt, around)
    assert jumps[[*WRISTS, KNEE]].all() and jumps.sum() <= 6
    still = frozen(spoilt, around, FPS)
    assert still[STILL, TOE].all() and still.sum() == STILL.stop - STILL.start


def test_what_leaves_all_its_neighbours_is_found_and_a_coarse_walk_is_not(worn, spoilt):
    around = neighbours_of(spoilt)
    assert leaving(spoilt, around)[[*WRISTS, KNEE]].all() and leaving(spoilt, around).sum() <= 4
    feet = [i for i, label in enumerate(LABELS) if label[1:] in ("ANK", "HEE", "TOE", "MT5")]
    coarse = worn_markers(LABELS, 60, fps=15.0, step=4).cloud.positions
    for points in (coarse, coarse[:, feet]):
        around = neighbours_of(points)
        assert jumping(points, around).any() and not leaving(points, around).any()
    gap = coarse[:, feet].copy()
    gap[20:30, 0] = np.nan
    assert not leaving(gap, neighbours_of(gap)).any()
    gap[30:, 0] += (0.0, 0.2, 0.2)
    assert leaving(gap, neighbours_of(gap))[0]


def test_faults_are_named_and_flagged(solution):
    flags = solution.motion.marker_flags
    expected = np.zeros_like(flags)
    expected[SWAP, WRISTS[0]] = expected[SWAP, WRISTS[1]] = MARKER_SWAPPED
    expected[GHOST, KNEE] = expected[STILL, TOE] = MARKER_GHOST
    np.testing.assert_array_equal(flags & (MARKER_SWAPPED | MARKER_GHOST), expected)
    np.testing.assert_array_equal((flags & MARKER_FILLED) > 0, expected == MARKER_GHOST)
    np.testing.assert_array_equal((flags & MARKER_SEEN) > 0, expected != MARKER_GHOST)
    found = {
        (f.code, f.where.markers, f.where.frames) for f in read_diagnostics(solution.motion.provenance["diagnostics"])
    }
    assert found == {
        ("markers_exchanged", ("LWRA", "LWRB"), ((20, 31),)),
        ("marker_ghost", ("RKNE",), ((50, 57),)),
        ("marker_still", ("LELB",), ((40, 89),)),
    }


def test_markers_that_a_program_holds_together_are_all_found(worn):
    held, around = worn.cloud.positions.copy(), neighbours_of(worn.cloud.positions)
    leg = [i for i, label in enumerate(LABELS) if label in ("LTHI", "LKNE", "LANK", "LHEE", "LTOE", "LMT5")]
    held[40:90, leg] = held[40, leg]
    still = frozen(held, around, FPS)
    assert still[40:90, leg].all() and still.sum() == 50 * len(leg)


def test_one_note_counts_the_markers_that_are_many():
    names = tuple("abcdefg")
    found = [diagnostic("marker_ghost", markers=[name], frames=[(k, k + 1)]) for k, name in enumerate(names)]
    assert gathered(found[:5]) == found[:5]
    (several,) = gathered(found)
    assert (several.code, several.where.markers, several.where.frames) == ("marker_ghost", names, ((0, 7),))
    assert sentence(several).startswith("Markers are at impossible positions: a, b, c, d, e, f and 1 more")


def test_faults_hardly_move_the_body(worn, solution):
    clean = solve(Capture("take", markers=worn.cloud)).motion
    moved = 1000 * np.linalg.norm(solution.motion.joints - clean.joints, axis=-1)
    assert moved.mean() < 5.0
    off = 1000 * np.linalg.norm(solution.motion.cleaned_markers - worn.cloud.positions, axis=-1)
    assert off[SWAP][:, WRISTS].max() < 1e-6
    assert off[GHOST, KNEE].mean() < 15.0 and np.isfinite(solution.motion.cleaned_markers).all()


def test_a_label_that_holds_its_neighbours_point_is_given_back():
    rng = np.random.default_rng(5)
    base = np.linspace(0, 0.6, 7)[:, None] * [1.0, 0.3, 0.0]
    points = base + np.cumsum(0.01 * rng.normal(size=(60, 1, 3)), axis=0)
    spoilt = points.copy()
    spoilt[20:30, 2], spoilt[20:30, 3] = points[20:30, 3], np.nan
    cleaned = clean_labels(spoilt, points + 0.01, neighbours_of(points, 4), np.ones(7, dtype=bool), 60.0)
    np.testing.assert_array_equal(cleaned.points[20:30, 3], points[20:30, 3])
    assert np.isnan(cleaned.points[20:30, 2]).all() and len(cleaned.faults) == 1


@pytest.mark.parametrize(("noise_m", "repaired"), [(0.003, True), (0.02, False)])
def test_the_noise_of_a_take_decides_whether_near_markers_are_swapped(noise_m, repaired):
    rng = np.random.default_rng(5)
    expected = 0.03 * np.arange(9)[:, None] * [1.0, 0.3, 0.0] + np.cumsum(0.01 * rng.normal(size=(60, 1, 3)), axis=0)
    points = expected + noise_m * rng.normal(size=expected.shape)
    spoilt = points.copy()
    spoilt[20:30, [3, 4]] = points[20:30, [4, 3]]
    cleaned = clean_labels(spoilt, expected, neighbours_of(points, 4), np.ones(9, dtype=bool), 60.0)
    assert np.array_equal(cleaned.points, points if repaired else spoilt)
