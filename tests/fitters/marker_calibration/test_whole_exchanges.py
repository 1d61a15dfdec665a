"""Labels exchanged in all of a take are found, named and put right, with and without a known person."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solver_backend.body.markers import marker_layout
from solver_backend.exchange.diagnostics import Remedy, diagnostic, read_diagnostics
from solver_backend.fitters import SolveSettings, solve
from solver_backend.fitters.marker_calibration.label_faults import exchanged_throughout
from solver_backend.fitters.pipeline import calibrate_person
from solver_backend.types import MARKER_SWAPPED, Capture
from tests.support.recordings import recordings_folder
from tests.support.worn_markers import worn_markers

LABELS = marker_layout("PLUGIN_GAIT_39")
PAIR = ("LELB", "LWRA")
BY_FRAME = SolveSettings(method="frame", iterations=4)


@pytest.fixture(scope="module")
def worn():
    return worn_markers(LABELS, 24, step=5)


@pytest.mark.slow
@pytest.mark.parametrize("known", [False, True])
def test_two_labels_are_exchanged_throughout(worn, known):
    person = calibrate_person([Capture("clean", markers=worn.cloud)]) if known else None
    clean = solve(Capture("take", markers=worn.cloud), BY_FRAME, person=person).motion
    swap = {PAIR[0]: PAIR[1], PAIR[1]: PAIR[0]}
    labels = tuple(swap.get(label, label) for label in LABELS)
    capture = Capture("take", markers=replace(worn.cloud, labels=labels))
    motion = solve(capture, BY_FRAME, person=person).motion
    found = read_diagnostics(motion.provenance["diagnostics"])
    assert found == (diagnostic("markers_exchanged", markers=PAIR, frames=[(0, 23)], remedy=Remedy.REPAIRED),)
    columns = [motion.marker_labels.index(name) for name in PAIR]
    assert (motion.marker_flags[:, columns] & MARKER_SWAPPED).all()
    assert 1000 * np.linalg.norm(motion.joints - clean.joints, axis=-1).mean() < 3.0


@pytest.mark.slow
def test_an_exchange_of_half_a_take_leaves_neither_name_to_be_used(worn):
    """Half of the frames say that the labels are exchanged, half that they are not: both are left out, and named."""
    pair = ("LKNE", "RKNE")
    points, columns = worn.cloud.positions.copy(), [LABELS.index(label) for label in pair]
    points[12:, columns] = points[12:, columns[::-1]]
    motion = solve(Capture("take", markers=replace(worn.cloud, positions=points)), BY_FRAME).motion
    found = read_diagnostics(motion.provenance["diagnostics"])
    assert [item.code for item in found] == ["markers_off_place"]
    assert all(item.where.markers == pair for item in found) and not set(pair) & set(motion.marker_labels)


def test_nothing_is_exchanged_where_nothing_is(worn):
    rng = np.random.default_rng(2)
    points = worn.cloud.positions
    assert exchanged_throughout(points, points + 0.02 * rng.normal(size=points.shape[1:])) == []


def test_the_noise_of_a_take_decides_how_far_apart_markers_must_be():
    rng = np.random.default_rng(3)
    expected = np.cumsum(0.02 * rng.normal(size=(16, 1, 3)), axis=0) + 0.03 * np.arange(9)[:, None] * [1.0, 0.0, 0.0]
    order = [0, 1, 2, 4, 3, 5, 6, 7, 8]
    assert exchanged_throughout(expected[:, order] + 0.003 * rng.normal(size=expected.shape), expected) == [(3, 4)]
    assert exchanged_throughout(expected[:, order] + 0.03 * rng.normal(size=expected.shape), expected) == []


RECORDINGS = recordings_folder() / "markers"


@pytest.mark.slow
@pytest.mark.skipif(not (RECORDINGS / "cmu_pairs").is_dir(), reason="the recordings are not beside the repository")
def test_recorded_labels_are_not_exchanged():
    from solver_backend.body.body import load_body
    from solver_backend.fitters.marker_calibration.label_faults import exchanged_labels
    from solver_backend.fitters.measurements.markers import known_markers_of, measure_markers
    from solver_backend.fitters.problem import Problem
    from solver_backend.io.markers.read import read_markers
    from solver_backend.priors.sposer import load_sposer

    body = load_body()
    for name in ("cmu_pairs/02_01.c3d", "nimble/Sprinter/run0350cms.trc", "nimble/Subject4/MarkerData/squats1.trc"):
        known = known_markers_of(read_markers(RECORDINGS / name).cloud)
        problem = Problem.of(body, load_sposer(), measure_markers(known, body, np.zeros(1)))
        assert exchanged_labels(problem, np.zeros(1)) == []
