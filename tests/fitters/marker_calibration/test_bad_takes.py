"""Takes of markers that are odd or impossible: each is solved, or refused by a named error."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solver_backend.body.markers import marker_layout
from solver_backend.exchange.errors import (
    JobInvalid,
    MarkersMirrored,
    MarkersUnknown,
    NoDetections,
    TakeTooShort,
)
from solver_backend.fitters import SolveSettings, solve
from solver_backend.fitters.measurements.markers import known_markers_of
from solver_backend.fitters.pipeline import calibrate_person
from solver_backend.io.load import load_capture
from solver_backend.io.markers.c3d import write_c3d
from solver_backend.types import Capture, MarkerCloud
from tests.support.recordings import recordings_folder
from tests.support.worn_markers import worn_markers

LABELS = marker_layout("PLUGIN_GAIT_39")
BY_FRAME = SolveSettings(method="frame", iterations=4)
MIRROR = np.array([1.0, -1.0, 1.0])


@pytest.fixture(scope="module")
def worn():
    return worn_markers(LABELS, 12, step=5)


@pytest.fixture(scope="module")
def person(worn):
    return calibrate_person([Capture("take", markers=worn.cloud)])


def capture_of(cloud: MarkerCloud, **changes) -> Capture:
    return Capture("take", markers=replace(cloud, **changes))


def test_unlabelled_markers_are_named(worn):
    with pytest.raises(MarkersUnknown, match="no labels"):
        solve(capture_of(worn.cloud, labels=None), BY_FRAME)


@pytest.mark.slow
def test_a_world_whose_origin_is_far_away_is_solved_as_well(worn, person):
    """Where single precision would tell places to 2 mm."""
    moved, quick = np.array([20_000.0, -10_000.0, 0.0]), SolveSettings(iterations=4)
    here = solve(capture_of(worn.cloud), quick, person=person).motion
    there = solve(capture_of(worn.cloud, positions=worn.cloud.positions + moved), quick, person=person).motion
    assert np.linalg.norm(there.joints - moved - here.joints, axis=-1).max() < 5e-4


def test_four_markers_are_too_few(worn):
    with pytest.raises(MarkersUnknown, match="needs 8 markers") as error:
        solve(capture_of(worn.cloud, positions=worn.cloud.positions[:, :4], labels=LABELS[:4]), BY_FRAME)
    assert "or add markers" in error.value.hint


@pytest.mark.parametrize(("word", "left_out"), [("skin", False), ("JointCentre", True)])
def test_a_dense_set_or_computed_points_are_not_told_to_add_markers(worn, word, left_out):
    points = np.concatenate([worn.cloud.positions + d for d in (0.0, 0.01, 0.02)], axis=1)
    cloud = MarkerCloud(points, 60.0, tuple(f"{word}_{k:03d}" for k in range(points.shape[1])))
    with pytest.raises(MarkersUnknown, match="needs 8 markers") as error:
        solve(Capture("take", markers=cloud), BY_FRAME)
    assert "add markers" not in error.value.hint and "`markers layout`" in error.value.hint
    assert ("Ignored as computed points" in str(error.value)) == left_out
    own = dict(zip(cloud.names, LABELS, strict=False))
    assert known_markers_of(cloud, own).names == tuple(own)


def test_two_people_are_asked_for_by_prefix(worn, tmp_path):
    points = np.concatenate([worn.cloud.positions, worn.cloud.positions + 1.0], axis=1)
    labels = (*(f"Anna:{label}" for label in LABELS), *(f"Bea:{label}" for label in LABELS))
    path = write_c3d(tmp_path / "two.c3d", MarkerCloud(points, 60.0, labels))
    with pytest.raises(JobInvalid, match="Anna .39 markers., Bea .39 markers.") as error:
        load_capture(path)
    assert "--subject-prefix" in error.value.hint
    assert load_capture(path, subject_prefix="Bea").markers.positions.shape[1] == 39


@pytest.mark.parametrize("how", ["an axis", "the labels"])
def test_a_mirror_image_is_named(worn, person, how):
    exchanged = tuple({"L": "R", "R": "L"}.get(label[0], label[0]) + label[1:] for label in LABELS if label != "RBAK")
    points, labels = worn.cloud.positions * MIRROR, LABELS
    if how == "the labels":
        points, labels = np.delete(worn.cloud.positions, LABELS.index("RBAK"), axis=1), exchanged
    for known in (None, person):
        with pytest.raises(MarkersMirrored, match="are mirrored"):
            solve(capture_of(worn.cloud, positions=points, labels=labels), BY_FRAME, person=known)


@pytest.mark.slow
def test_a_single_frame_is_solved_by_the_method_for_it(worn, person):
    one = capture_of(worn.cloud, positions=worn.cloud.positions[:1])
    with pytest.raises(TakeTooShort, match="needs 4 frames"):
        solve(one)
    motion = solve(one, BY_FRAME).motion
    assert motion.num_frames == 1 and np.nanmedian(motion.marker_residual_mm) < 12.0
    assert solve(one, BY_FRAME, person=person).motion.num_frames == 1


@pytest.mark.slow
def test_a_take_that_lies_is_solved_as_one_that_stands(worn, person):
    lying = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    motion = solve(capture_of(worn.cloud, positions=worn.cloud.positions @ lying.T), BY_FRAME, person=person).motion
    upright = solve(capture_of(worn.cloud), BY_FRAME, person=person).motion
    off = 1000 * np.linalg.norm(motion.joints - upright.joints @ lying.T, axis=-1)
    assert np.median(off) < 3.0


@pytest.mark.slow
def test_a_marker_at_the_origin_is_missing(worn, tmp_path):
    points = worn.cloud.positions.copy()
    points[:, 3] = 0.0
    capture = load_capture(write_c3d(tmp_path / "origin.c3d", replace(worn.cloud, positions=points)))
    assert capture.markers is not None and np.isnan(capture.markers.positions[:, 3]).all()
    motion = solve(capture, BY_FRAME).motion
    assert np.isfinite(motion.markers).all() and np.isnan(motion.marker_residual_mm[:, 3]).all()


def test_nothing_to_calibrate_is_named():
    with pytest.raises(NoDetections, match="no markers"):
        calibrate_person([Capture("empty")])


def test_nobody_is_refused(worn):
    with pytest.raises(NoDetections):
        solve(capture_of(worn.cloud, positions=np.full_like(worn.cloud.positions, np.nan)), BY_FRAME)


RECORDINGS = recordings_folder() / "markers"


@pytest.mark.slow
@pytest.mark.skipif(not (RECORDINGS / "cmu_pairs").is_dir(), reason="the recordings are not beside the repository")
def test_recorded_people_are_no_mirror_images():
    from solver_backend.body.body import load_body
    from solver_backend.fitters.marker_calibration.label_evidence import check_sides
    from solver_backend.fitters.measurements.markers import known_markers_of, measure_markers
    from solver_backend.io.markers.read import read_markers

    body = load_body()
    names = ("cmu_pairs/02_01.c3d", "cmu_pairs/135_02.c3d", "nimble/Sprinter/run0350cms.trc")
    for cloud in (read_markers(RECORDINGS / name).cloud for name in names):
        known = known_markers_of(cloud)
        measured = measure_markers(known, body, np.zeros(1))
        check_sides(measured.points, measured.landmarks)
        with pytest.raises(MarkersMirrored):
            check_sides(measured.points * MIRROR, measured.landmarks)
