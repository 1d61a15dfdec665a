"""Faults of a view are named, with the camera and the frame, and cost the solve little."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from research.simulation import bad_input
from solver_backend.cameras.projection import project
from solver_backend.cameras.robust_triangulation import triangulate
from solver_backend.exchange.diagnostics import Diagnostic, Remedy, Severity, read_diagnostics, sentence
from solver_backend.exchange.progress import silent
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters import solve
from solver_backend.fitters.measurements.sanitise import CheckedCapture, check_capture
from solver_backend.io.load import load_capture
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.types import FLAG_UNSEEN, SMPL_JOINTS, Capture, Motion
from tests.support.faulty import swapped, with_detections
from tests.support.recordings import BALANCING_TRIAL
from tests.support.words import words

QUICK = SolveSettings(iterations=4)
VIEW, NAME = 1, "cam02"
LAST = 119


@pytest.fixture(scope="module")
def capture() -> Capture:
    return demo_capture(num_frames=LAST + 1)


@pytest.fixture(scope="module")
def clean(capture) -> Motion:
    return solve(capture, QUICK).motion


def checked(capture: Capture, **options: bool) -> CheckedCapture:
    cameras, keypoints = capture.require_multiview()
    return check_capture(capture, triangulate(cameras, keypoints.xy, keypoints.confidence), silent, **options)


def points_mm(found: CheckedCapture, capture: Capture) -> float:
    error = np.linalg.norm(found.triangulation.points - capture.truth["keypoints3d"], axis=-1)
    return 1000 * float(np.nanmean(error))


def error_mm(motion: Motion, capture: Capture) -> float:
    return 1000 * float(np.linalg.norm(motion.joints - capture.truth["joints"], axis=-1).mean())


def named(found: Diagnostic) -> tuple[str, tuple[str, ...], Remedy]:
    return found.code, found.where.cameras, found.remedy


def views(capture: Capture, count: int) -> Capture:
    return capture.views(list(range(count)))


@pytest.mark.parametrize("count", [2, 3, 4])
def test_a_good_capture_has_no_findings_and_is_left_as_it_is(capture, count):
    found = checked(views(capture, count), estimate_sync=True)
    assert found.diagnostics == ()
    np.testing.assert_array_equal(found.capture.keypoints.xy, capture.keypoints.xy[:count])


@pytest.mark.slow
@pytest.mark.shared
def test_the_real_recording_has_no_findings_beside_those_of_its_reader(shared_data):
    recording = load_capture(shared_data / BALANCING_TRIAL)
    assert any("cam_01 21, cam_03 31" in problem for problem in words(recording.problems))
    assert checked(recording).diagnostics == ()


@pytest.mark.slow
@pytest.mark.parametrize("count", [3, 4])
@pytest.mark.parametrize("first", [0, 50])
def test_a_bumped_camera_is_named_and_turned_back(capture, count, first):
    few = views(capture, count)
    found = checked(bad_input.bumped(few, VIEW, 5.0, first))
    (fault,) = found.diagnostics
    assert named(fault) == ("camera_turned", (NAME,), Remedy.REPAIRED)
    assert fault.values["size"] == pytest.approx(5.0, abs=0.2)
    ((begin, end),) = fault.where.frames
    assert (abs(begin - first) <= 3, end) == (True, LAST)
    assert points_mm(found, few) < 1.1 * points_mm(checked(few), few)


@pytest.mark.slow
@pytest.mark.parametrize("count", [3, 4])
@pytest.mark.parametrize(
    ("spoil", "kind"),
    [(bad_input.mirrored, "image_mirrored"), (bad_input.sides_exchanged, "detections_corrected")],
)
def test_a_mirrored_view_is_named_and_turned_round(capture, count, spoil, kind):
    few = views(capture, count)
    found = checked(spoil(few, VIEW))
    (fault,) = found.diagnostics
    assert named(fault) == (kind, (NAME,), Remedy.REPAIRED)
    assert fault.where.frames == ((0, LAST),)
    np.testing.assert_allclose(found.capture.keypoints.xy, few.keypoints.xy, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(("count", "pair"), [(3, (0, 2)), (3, (1, 2)), (4, (0, 2)), (4, (1, 2))])
def test_exchanged_names_are_named_and_put_right(capture, count, pair):
    few = views(capture, count)
    found = checked(bad_input.calibrations_exchanged(few, *pair))
    (fault,) = found.diagnostics
    assert (fault.code, fault.remedy) == ("camera_names_exchanged", Remedy.REPAIRED)
    assert set(fault.where.cameras) == {few.cameras.names[view] for view in pair}
    assert fault.where.frames == ((0, LAST),)
    assert points_mm(found, few) < 1.05 * points_mm(checked(few), few)


@pytest.mark.slow
@pytest.mark.parametrize("order", [(1, 2, 3, 0), (1, 0, 3, 2)])
def test_names_in_another_order_are_put_right(capture, order):
    cameras = capture.cameras
    wrong = replace(capture, cameras=replace(cameras.subset(list(order)), names=cameras.names))
    found = checked(wrong)
    (fault,) = found.diagnostics
    assert (fault.code, set(fault.where.cameras)) == ("camera_names_exchanged", set(cameras.names))
    owners = [cameras.names[order.index(view)] for view in range(len(order))]
    assert fault.values["pairs"] == [
        f"{n} is the calibration's {o}" for n, o in zip(cameras.names, owners, strict=True)
    ]
    assert points_mm(found, capture) < 1.05 * points_mm(checked(capture), capture)


@pytest.mark.slow
def test_slightly_late_cameras_are_named_and_moved(capture):
    late = bad_input.unsynchronised(bad_input.unsynchronised(capture, VIEW, 2), 3, -2)
    found = checked(late)
    assert [named(f) for f in found.diagnostics] == [
        ("camera_late", (NAME,), Remedy.REPAIRED),
        ("camera_late", ("cam04",), Remedy.REPAIRED),
    ]
    np.testing.assert_allclose([f.values["size"] for f in found.diagnostics], [2.0, 2.0], atol=0.3)
    assert points_mm(found, capture) < 1.1 * points_mm(checked(capture), capture)


@pytest.mark.slow
def test_a_delay_of_one_frame_is_reported_as_possible_in_two_seconds(capture):
    (fault,) = checked(bad_input.unsynchronised(capture, VIEW, 1)).diagnostics
    assert named(fault) == ("delay_unknown", (NAME,), Remedy.REPORTED)
    assert fault.values["low"] <= 0 and 1 <= fault.values["high"] <= 2


def test_a_person_who_stands_still_leaves_the_delays_unknown(capture):
    _, keypoints = capture.require_multiview()
    rng = np.random.default_rng(4)
    xy = np.repeat(keypoints.xy[:, :1], LAST + 1, axis=1) + rng.normal(size=keypoints.xy.shape)
    (fault,) = checked(
        with_detections(capture, xy, np.repeat(keypoints.confidence[:, :1], LAST + 1, axis=1))
    ).diagnostics
    assert named(fault) == ("delay_unknown", (), Remedy.REPORTED)
    assert "too little movement to exclude delays of up to 24 frames" in sentence(fault)


def test_a_view_that_sees_the_person_briefly_is_not_said_to_show_too_little_movement(capture):
    _, keypoints = capture.require_multiview()
    xy, confidence = keypoints.xy.copy(), keypoints.confidence.copy()
    xy[VIEW, 12:], confidence[VIEW, 12:] = np.nan, 0.0
    unknown = [f for f in checked(with_detections(capture, xy, confidence)).diagnostics if f.code == "delay_unknown"]
    assert [(named(f)[1], f.severity) for f in unknown] == [((NAME,), Severity.WARNING)]
    assert "visible in only 12 of 120 frames" in sentence(unknown[0]) and "movement" not in sentence(unknown[0])


@pytest.mark.slow
def test_a_very_late_camera_is_named_and_moved(capture):
    found = checked(bad_input.unsynchronised(capture, VIEW, 6))
    (fault,) = found.diagnostics
    assert named(fault) == ("camera_late", (NAME,), Remedy.REPAIRED)
    assert fault.values["size"] == pytest.approx(6.0, abs=0.3)
    assert points_mm(found, capture) < 1.1 * points_mm(checked(capture), capture)


@pytest.mark.slow
def test_somebody_else_in_one_view_is_left_out(capture):
    """For half a second the view shows another person, a metre and a half away and in another pose."""
    cameras, keypoints = capture.require_multiview()
    other = capture.truth["keypoints3d"][::-1] + [1.2, 0.9, 0.0]
    px = project(cameras, other)
    xy = keypoints.xy.copy()
    xy[VIEW, 40:70] = px[VIEW, 40:70]
    confidence = keypoints.confidence.copy()
    confidence[VIEW, 40:70] = 0.9
    found = checked(with_detections(capture, xy, confidence))
    (fault,) = found.diagnostics
    assert named(fault) == ("contradicts", (NAME,), Remedy.EXCLUDED)
    np.testing.assert_allclose(fault.where.frames[0], (40, 69), atol=2)
    assert points_mm(found, capture) < 1.1 * points_mm(checked(capture), capture)


def test_an_absence_is_named(capture):
    found = checked(bad_input.away(capture, 50, 0.5))
    (fault,) = found.diagnostics
    assert named(fault) == ("person_away", (), Remedy.BRIDGED)
    np.testing.assert_allclose(fault.where.frames[0], (50, 79), atol=7)


@pytest.mark.slow
def test_an_absence_is_bridged_upright_and_costs_the_rest_nothing(capture, clean):
    motion = solve(bad_input.away(capture, 40, 0.8), QUICK).motion
    assert motion.flags is not None
    unseen = (motion.flags & FLAG_UNSEEN) > 0
    np.testing.assert_allclose(np.flatnonzero(unseen)[[0, -1]], [40, 87], atol=7)
    error, usual = (np.linalg.norm(m.joints - capture.truth["joints"], axis=-1).mean(-1) for m in (motion, clean))
    assert error[~unseen].mean() < 1.25 * usual[~unseen].mean()
    spine = motion.joints[:, SMPL_JOINTS.index("neck")] - motion.joints[:, 0]
    lean = np.degrees(np.arccos(spine[:, 2] / np.linalg.norm(spine, axis=-1)))
    assert lean[unseen].max() < 15.0
    speed = np.linalg.norm(np.diff(motion.joints, axis=0), axis=-1).max(axis=1)
    assert speed[unseen[:-1]].max() < 1.1 * speed[~unseen[:-1]].max()


def test_a_solve_names_what_it_found_and_is_as_good_as_a_clean_one(capture, clean):
    """A bumped camera and exchanged limbs of others at once."""
    assert [item["code"] for item in clean.provenance["diagnostics"]] == ["stature_solved"]
    bad = bad_input.bumped(swapped(capture, [(2, "legs", 20, 42), (0, "arms", 60, 71)]), VIEW, 5.0, 50)
    motion = solve(bad, replace(QUICK, estimate_sync=True)).motion
    found = read_diagnostics(motion.provenance["diagnostics"])
    assert [(f.code, f.where.cameras, f.values.get("part")) for f in found] == [
        ("limbs_exchanged", ("cam03",), "legs"),
        ("camera_turned", (NAME,), None),
        ("limbs_exchanged", ("cam01",), "arms"),
        ("stature_solved", (), None),
    ]
    assert error_mm(motion, capture) < 1.15 * error_mm(clean, capture)


@pytest.mark.slow
def test_a_recording_at_half_its_rate_is_solved_from_the_frames_it_has(capture, clean):
    keypoints = capture.keypoints
    frames = np.arange(LAST + 1) // 2 * 2
    result = checked(with_detections(capture, keypoints.xy[:, frames], keypoints.confidence[:, frames]))
    kinds = [(fault.code, fault.remedy) for fault in result.diagnostics]
    assert kinds.count(("frames_repeated", Remedy.BRIDGED)) == len(capture.cameras)
    motion = solve(with_detections(capture, keypoints.xy[:, frames], keypoints.confidence[:, frames]), QUICK).motion
    truth = capture.truth["joints"]
    error, best = (float(np.linalg.norm(m.joints - truth, axis=-1).mean()) for m in (motion, clean))
    assert error < 1.15 * best
