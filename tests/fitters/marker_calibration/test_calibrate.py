"""A person learned from markers: shape, places and their spread, and the record of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.body.marker_layouts import load_layouts
from solver_backend.body.markers import MARKER_OFFSET_M, marker_layout
from solver_backend.exchange.errors import FileDamaged, SubjectInvalid
from solver_backend.fitters import SolveSettings, solve
from solver_backend.fitters.marker_calibration.calibrate import FRAMES, POSE_FRAMES, varied_frames
from solver_backend.fitters.pipeline import calibrate_person
from solver_backend.io.load import load_capture
from solver_backend.io.native.motion_file import read_subject, write_subject
from solver_backend.types import Capture, MarkerCloud, MarkerSubject
from tests.support.worn_markers import worn_markers

LABELS = marker_layout("PLUGIN_GAIT_39")


@pytest.fixture(scope="module")
def worn():
    return worn_markers(LABELS, 40, fps=10.0, step=6)


@pytest.fixture(scope="module")
def person(worn) -> MarkerSubject:
    return calibrate_person([Capture("take", markers=worn.cloud)])


def capture_of(cloud: MarkerCloud) -> Capture:
    return Capture("take", markers=cloud)


def test_shape_and_places_are_those_of_the_person(worn, person):
    body, truth = load_body(), worn.betas
    ours, theirs = body.rest_joints(person.betas), body.rest_joints(truth)
    length = np.linalg.norm(ours[1:] - ours[list(body.parents[1:])], axis=-1)
    true = np.linalg.norm(theirs[1:] - theirs[list(body.parents[1:])], axis=-1)
    assert np.abs(length - true)[:21].max() < 0.012
    assert np.median(np.linalg.norm(person.offsets - worn.offsets, axis=-1)) < 0.010
    assert person.places == tuple(load_layouts().place_of(label) for label in LABELS)
    assert (person.sigma_m < 0.006).all() and abs(np.median(person.skin_m) - MARKER_OFFSET_M) < 0.01


@pytest.mark.slow
def test_poses_that_count_less_leave_markers_on_their_places(monkeypatch):
    """Where every marker sits on its place, what is known of poses moves them the less the less it counts."""
    assert POSE_FRAMES < FRAMES
    monkeypatch.setattr("solver_backend.fitters.marker_calibration.calibrate.POSE_FRAMES", 1.0)
    worn = worn_markers(marker_layout("MANIFOLD_53"), 16, step=10, stray_m=0.0)
    found = calibrate_person([capture_of(worn.cloud)])
    assert np.median(np.linalg.norm(found.offsets, axis=-1)) < 0.003
    body = load_body()
    off = np.linalg.norm(body.rest_joints(found.betas) - body.rest_joints(worn.betas), axis=-1)
    assert off[:22].mean() < 0.0012


def limited(monkeypatch, capture: Capture, limit: float) -> MarkerSubject:
    monkeypatch.setattr("solver_backend.fitters.marker_calibration.calibrate.SHAPE_LIMIT", limit)
    monkeypatch.setattr("solver_backend.fitters.marker_calibration.calibrate.BEYOND_START", 0.0)
    return calibrate_person([capture])


@pytest.mark.slow
def test_a_shape_of_part_of_a_body_is_held_at_its_limit(monkeypatch):
    take = capture_of(worn_markers([label for label in LABELS if "HD" not in label], 12, step=20).cloud)
    free = limited(monkeypatch, take, 9.0)
    limit = 0.6 * float(np.abs(free.betas).max())
    held = limited(monkeypatch, take, limit)
    assert np.abs(held.betas).max() == pytest.approx(limit, abs=0.01)
    assert np.median(held.sigma_m) < 1.1 * np.median(free.sigma_m)


@pytest.mark.slow
def test_a_limit_changes_nothing_where_the_shape_lies_within(monkeypatch, shared_data):
    """The fit passes the limit on its way: a wall there ended it early, with markers a third farther off."""
    capture = load_capture(shared_data / "markers" / "opensim" / "constraintTest.trc")
    assert capture.markers is not None
    cloud = replace(capture.markers, positions=capture.markers.positions[:400:16], residual=None)
    free, held = (limited(monkeypatch, replace(capture, markers=cloud), limit) for limit in (9.0, 3.5))
    np.testing.assert_array_equal(held.betas, free.betas)
    np.testing.assert_array_equal(held.offsets, free.offsets)


def test_a_heel_marker_stays_at_the_heel(person):
    heels = [i for i, label in enumerate(LABELS) if label.endswith("HEE")]
    assert (np.linalg.norm(person.offsets[heels], axis=-1) < 0.04).all()


@pytest.mark.slow
def test_a_known_person_is_solved_without_calibration(worn, person):
    stages: list[str] = []
    solution = solve(capture_of(worn.cloud), person=person, progress=lambda stage, done, of: stages.append(stage))
    assert "Calibrating the person" not in stages and stages
    error = 1000 * np.linalg.norm(solution.motion.joints - worn.joints, axis=-1)
    assert error.mean() < 12.0
    np.testing.assert_array_equal(solution.motion.betas, person.betas)
    np.testing.assert_array_equal(solution.motion.offsets, person.offsets)


def test_a_subject_file_is_read_back(tmp_path, person):
    path = write_subject(tmp_path / "anna.npz", person)
    back = read_subject(path)
    assert back.labels == person.labels and back.places == person.places and back.body == person.body
    for name in ("betas", "offsets", "sigma_m", "skin_m"):
        np.testing.assert_array_equal(getattr(back, name), getattr(person, name))
    assert back.provenance["frames"] == person.provenance["frames"]
    np.savez(tmp_path / "other.npz", format="something_else", version=1)
    with pytest.raises(FileDamaged):
        read_subject(tmp_path / "other.npz")


def test_labels_match_without_prefix_and_order(worn, person):
    order = np.random.default_rng(0).permutation(len(LABELS))
    cloud = MarkerCloud(worn.cloud.positions[:, order], 60.0, tuple(f"Bea:{LABELS[i].lower()}" for i in order))
    short = replace(cloud, positions=cloud.positions[:8])
    motion = solve(capture_of(short), SolveSettings(method="frame"), person=person).motion
    assert set(motion.marker_labels) == set(cloud.labels)
    assert np.nanmedian(motion.marker_residual_mm) < 8.0


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"body": "somebody_else"}, "calibrated on the body"),
        ({"labels": tuple(f"X{i}" for i in range(39))}, "Only 0 of the subject's 39 markers"),
    ],
)
def test_another_body_or_layout_is_named(worn, person, change, says):
    with pytest.raises(SubjectInvalid, match=says):
        solve(capture_of(worn.cloud), person=replace(person, **change))


@pytest.mark.parametrize(
    "change", [{"betas": np.full(10, np.nan)}, {"offsets": np.zeros((2, 3))}, {"sigma_m": np.zeros(39)}]
)
def test_impossible_values_are_refused(person, change):
    with pytest.raises(SubjectInvalid):
        replace(person, **change)


def test_frames_are_chosen_for_variety():
    rng = np.random.default_rng(2)
    still = np.repeat(rng.normal(size=(1, 6, 3)), 200, axis=0) + 1e-4 * rng.normal(size=(200, 6, 3))
    moved = still.copy()
    moved[[50, 90, 130]] += rng.normal(size=(3, 6, 3))
    moved[60] = np.nan
    chosen = varied_frames(moved, 5)
    assert {50, 90, 130} <= set(chosen.tolist()) and 60 not in chosen and len(chosen) == 5
