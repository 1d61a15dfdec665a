"""A take of one camera: near the truth as far as a picture goes, and never surer than that."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from research.simulation.benchmark import BenchmarkSettings, benchmark_capture
from solver_backend.exchange.diagnostics import read_diagnostics
from solver_backend.exchange.errors import NoDetections
from solver_backend.exchange.progress import silent
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters.hands.solve_hands import Hands
from solver_backend.fitters.pipeline import prepare, solve
from solver_backend.geometry.small_matrices import unpacked
from solver_backend.report.checks import diagnose
from solver_backend.types import FLAG_UNSEEN, Capture, Motion
from tests.support.limb_errors import LIMBS, coverage, limb_errors
from tests.support.walking_take import circling


@pytest.fixture(scope="module")
def filmed() -> Capture:
    return benchmark_capture(circling(90), BenchmarkSettings(num_views=2, calibration_mm=0.0)).views([0])


@pytest.fixture(scope="module")
def motion(filmed: Capture) -> Motion:
    return solve(filmed).motion


@pytest.mark.slow
def test_cameras_that_see_nobody_change_nothing() -> None:
    two = benchmark_capture(circling(60), BenchmarkSettings(num_views=2, calibration_mm=0.0))
    assert two.keypoints is not None
    confidence = two.keypoints.confidence * np.array([1.0, 0.0])[:, None, None]
    beside = replace(two, keypoints=replace(two.keypoints, confidence=confidence))
    points = [prepare(take, SolveSettings(), silent).measurements.points for take in (two.views([0]), beside)]
    np.testing.assert_array_equal(*points)


def along_and_across(capture: Capture, motion: Motion) -> tuple[np.ndarray, np.ndarray]:
    assert capture.cameras is not None and motion.joint_covariance is not None
    covariance = unpacked(motion.joint_covariance.astype(float))[:, LIMBS]
    away = motion.joints[:, LIMBS] - capture.cameras.centres[0]
    sight = away / np.linalg.norm(away, axis=-1, keepdims=True)
    along = np.einsum("fja,fjab,fjb->fj", sight, covariance, sight)
    across = 0.5 * (np.trace(covariance, axis1=-2, axis2=-1) - along)
    return np.sqrt(along), np.sqrt(across)


def test_a_walk_is_found_and_its_feet_stay_over_the_floor(filmed: Capture, motion: Motion) -> None:
    pa, hip = limb_errors(motion.joints, filmed.truth["joints"])
    assert pa < 60.0 and hip < 100.0
    assert motion.keypoints3d is not None and motion.keypoints3d[..., 2].min() > -0.021
    assert np.linalg.norm(motion.joints.mean(1) - filmed.truth["joints"].mean(1), axis=-1).mean() < 0.4


def test_deviations_are_largest_along_the_line_of_sight(filmed: Capture, motion: Motion) -> None:
    along, across = along_and_across(filmed, motion)
    assert np.median(along) > 2.0 * np.median(across) and np.median(along) > 0.08
    assert coverage(motion, filmed.truth["joints"]) > 80.0


def test_one_camera_is_always_said(filmed: Capture, motion: Motion) -> None:
    found = {item.code: item for item in diagnose(filmed, motion)}
    assert found["one_camera"].severity.value == "warning" and found["one_camera"].values["share"] > 1.0
    assert "keypoints_seldom_seen" not in found
    assert "one_camera" in {item.code for item in read_diagnostics(motion.provenance["diagnostics"])}
    assert not {"focal_length_unsure", "up_from_person"} & set(found)


def test_a_given_stature_is_the_persons_and_leaves_less_open(filmed: Capture) -> None:
    short = replace(filmed, keypoints=filmed.keypoints and filmed.keypoints.frames(0, 30), truth={})
    tall, unknown = (
        solve(replace(short, **known)).motion for known in ({"stature_m": 1.9}, {"floor_from_person": True})
    )
    legs = [np.linalg.norm(m.joints[0, 4] - m.joints[0, 7]) for m in (tall, unknown)]
    assert legs[0] > 1.05 * legs[1]
    sure, unsure = (np.median(along_and_across(short, m)[0]) for m in (tall, unknown))
    assert sure < 0.8 * unsure
    rough = replace(short, stature_m=1.9, focal_sigma=0.15, floor_from_person=True)
    guessed = solve(rough).motion
    assert np.median(along_and_across(short, guessed)[0]) > 2.5 * sure
    assert {"focal_length_unsure", "up_from_person"} < {item.code for item in diagnose(rough, guessed)}


@pytest.mark.slow
def test_who_is_not_seen_for_a_while_is_flagged(filmed: Capture) -> None:
    assert filmed.keypoints is not None
    confidence = filmed.keypoints.confidence.copy()
    confidence[:, 30:50] = 0.0
    hidden = replace(filmed, keypoints=replace(filmed.keypoints, confidence=confidence))
    motion = solve(hidden).motion
    assert motion.flags is not None and ((motion.flags & FLAG_UNSEEN) > 0)[30:50].all()
    assert "frames_unseen" in {item.code for item in diagnose(hidden, motion)}
    speed = np.linalg.norm(np.diff(motion.joints, axis=0), axis=-1) * motion.fps
    assert speed[28:52].max() < 8.0


def test_too_little_of_a_person_is_an_error(filmed: Capture) -> None:
    assert filmed.keypoints is not None
    confidence = np.zeros_like(filmed.keypoints.confidence)
    confidence[:, :, :4] = 0.9
    with pytest.raises(NoDetections, match="enough detected keypoints"):
        solve(replace(filmed, keypoints=replace(filmed.keypoints, confidence=confidence)), SolveSettings())


def test_hands_of_one_camera_are_measured_and_named(filmed: Capture) -> None:
    assert filmed.keypoints is not None
    hands = np.full((*filmed.keypoints.confidence.shape[:2], 2, 21, 3), 0.5, np.float32)
    for shown, expected in ((hands, True), (np.zeros_like(hands), False)):
        with_hands = replace(filmed, keypoints=replace(filmed.keypoints, hands=shown))
        measured = prepare(with_hands, SolveSettings(), silent).measurements
        codes = {item.code for item in read_diagnostics(measured.provenance["diagnostics"])}
        assert ("hands_one_view" in codes) == expected == any(isinstance(layer, Hands) for layer in measured.layers)
