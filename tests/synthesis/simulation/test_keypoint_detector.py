"""The detector errs as its model says, and says itself where."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solver_backend.synthesis.faults import MEASURED_DETECTOR, DetectorFaults
from solver_backend.synthesis.simulation.keypoint_detector import (
    DetectorOutput,
    Sight,
    bias_by_direction,
    detect_keypoints,
)
from solver_backend.types import JointSet
from tests.support.walking_take import EXACT

SHAPE = (4, 600, 25)


def _detect(
    model: DetectorFaults, occluded: np.ndarray | None = None, fps: float = 60.0, seed: int = 1
) -> DetectorOutput:
    hidden = np.zeros(SHAPE, dtype=bool) if occluded is None else occluded
    sight = Sight(_truth(), np.full(SHAPE, 0.3), _seen_from(), hidden, np.tile([1920, 1080], (4, 1)))
    return detect_keypoints(sight, JointSet.BODY_25, fps, model, np.random.default_rng(seed))


def _seen_from() -> np.ndarray:
    return np.array([0.0, 0.0, 2.0, 4.0])[:, None] + np.linspace(0, 1, SHAPE[1])


def _truth() -> np.ndarray:
    return np.random.default_rng(0).uniform(400, 700, (*SHAPE, 2))


def test_a_detector_without_errors_tells_the_truth() -> None:
    assert np.array_equal(_detect(EXACT).xy, _truth())


def test_drift_has_its_size_and_time_constant_at_any_frame_rate() -> None:
    for fps in (60.0, 30.0):
        error = (_detect(replace(EXACT, drift_mm=10.0, drift_s=0.19, unevenness=0.0), fps=fps).xy - _truth()) / 0.3
        assert error.std() == pytest.approx(10.0, rel=0.04)
        correlation = (error[:, 1:] * error[:, :-1]).mean() / (error**2).mean()
        assert correlation == pytest.approx(np.exp(-1 / (0.19 * fps)), abs=0.02)


def test_some_keypoints_are_steadier_than_others() -> None:
    error = (_detect(replace(EXACT, jitter_mm=10.0, unevenness=0.4)).xy - _truth()) / 0.3
    spread = np.log(error.std(axis=(1, 3)))
    assert spread.std() == pytest.approx(0.4, abs=0.08)
    assert error.std() == pytest.approx(10.0, rel=0.15)


def test_bias_belongs_to_the_direction_the_person_is_seen_from() -> None:
    error = (_detect(replace(EXACT, view_bias_mm=9.0)).xy - _truth()) / 0.3
    assert np.allclose(error[0], error[1])
    assert np.abs(error[0] - error[2]).mean() > 3.0
    assert np.linalg.norm(np.diff(error, axis=1), axis=-1).max() < 0.2
    everywhere = bias_by_direction(np.linspace(0, 2 * np.pi, 50)[None], 400, np.random.default_rng(3))
    assert np.allclose(everywhere.std(axis=(0, 2, 3)), 1.0, atol=0.1)


def test_hidden_keypoints_are_missing_in_runs_of_the_asked_share() -> None:
    occluded = np.zeros(SHAPE, dtype=bool)
    occluded[:, :, :10] = True
    missing = np.isnan(_detect(replace(EXACT, occluded_missing=0.5), occluded).xy).all(-1)
    assert missing[..., :10].mean() == pytest.approx(0.5, abs=0.06)
    assert not missing[..., 10:].any()


def test_exchanged_limbs_are_whole_limbs_of_one_view_for_2_to_30_frames() -> None:
    found = _detect(replace(EXACT, swaps_per_minute=6.0))
    mirrored = list(JointSet.BODY_25.mirrored())
    assert found.swapped.any()
    assert np.array_equal(found.swapped, found.swapped[:, :, mirrored])
    assert np.array_equal(found.xy, np.where(found.swapped[..., None], _truth()[:, :, mirrored], _truth()))
    names = JointSet.BODY_25.keypoints
    knee = found.swapped[:, :, names.index("left_knee")]
    assert np.array_equal(knee, found.swapped[:, :, names.index("right_heel")])
    assert not found.swapped[:, :, names.index("nose")].any()
    edges = np.flatnonzero(np.diff(np.pad(knee, ((0, 0), (1, 1))).astype(int), axis=1).ravel())
    assert (np.diff(edges)[::2] >= 2).all() or not edges.size
    told = np.zeros_like(knee)
    for view, limb, start, stop in found.swaps:
        assert 2 <= stop - start <= 30
        told[view, start:stop] |= limb == 1
    assert np.array_equal(told, knee)


def test_outliers_are_told_and_lie_far() -> None:
    found = _detect(replace(EXACT, outliers=0.05, outlier_mm=220.0))
    far = np.linalg.norm(found.xy - _truth(), axis=-1) / 0.3 > 109.9
    assert found.outlier.mean() == pytest.approx(0.05, abs=0.008)
    assert np.array_equal(far, found.outlier)


def test_confidences_tell_part_of_the_truth_and_the_same_seed_the_same_take() -> None:
    found, again = _detect(MEASURED_DETECTOR), _detect(MEASURED_DETECTOR)
    assert np.array_equal(found.xy, again.xy, equal_nan=True) and np.array_equal(found.confidence, again.confidence)
    seen = found.confidence > 0
    error = np.linalg.norm(found.xy - _truth(), axis=-1)
    ranks = [np.argsort(np.argsort(v[seen])) for v in (error, found.confidence)]
    assert -0.4 < np.corrcoef(ranks)[0, 1] < -0.18
    assert np.array_equal(seen, np.isfinite(found.xy).all(-1))
