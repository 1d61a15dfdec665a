"""Every baseline solves the demo, each to its own degree."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from research.baselines import (
    DCT,
    DMMR,
    ETC,
    Baseline,
    BundleMoCap,
    BundleMoCapPlusPlus,
    MuVS,
    TriangulatedButterworth,
)
from solver_backend.exchange.errors import JobInvalid, NoDetections
from solver_backend.metrics import mpjpe_mm
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.types import Capture

BODIES = (MuVS(), DCT(), ETC(), DMMR(), BundleMoCap(), BundleMoCapPlusPlus(), BundleMoCapPlusPlus(start="previous"))


@pytest.fixture(scope="module")
def capture() -> Capture:
    return demo_capture(num_frames=41)


@pytest.mark.parametrize(
    ("baseline", "bound_mm"),
    [(TriangulatedButterworth(), 40.0), *((method, 45.0) for method in BODIES)],
    ids=lambda value: getattr(value, "name", ""),
)
def test_a_baseline_finds_the_person(capture: Capture, baseline: Baseline, bound_mm: float) -> None:
    result = baseline.solve(capture)
    assert result.keypoints3d.shape == capture.truth["keypoints3d"].shape
    assert mpjpe_mm(result.keypoints3d, capture.truth["keypoints3d"]) < bound_mm
    if result.motion is not None:
        assert mpjpe_mm(result.motion.joints, capture.truth["joints"]) < bound_mm


def test_the_published_windows_are_20_frames_and_30_iterations(capture: Capture) -> None:
    result = BundleMoCapPlusPlus().solve(capture)
    assert result.motion is not None and result.motion.keyframes is not None
    assert np.flatnonzero(result.motion.keyframes).tolist() == [0, 10, 20, 30, 40]
    assert result.statistics["windows"] == 2
    assert result.statistics["iterations"] <= 60


@pytest.mark.parametrize(
    ("changes", "keys"),
    [({"interpolation": 4, "window": 40}, range(0, 41, 10)), ({"interpolation": 1, "window": 10}, range(0, 41, 10)),
     ({"root": "se3"}, range(0, 41, 10))],
)  # fmt: skip
def test_other_curves_through_other_keys_find_the_person_too(capture: Capture, changes: dict, keys: range) -> None:
    result = BundleMoCapPlusPlus(**changes).solve(capture)
    assert result.motion is not None and result.motion.keyframes is not None
    assert np.flatnonzero(result.motion.keyframes).tolist() == list(keys)
    assert mpjpe_mm(result.motion.joints, capture.truth["joints"]) < 45.0


@pytest.mark.parametrize("changes", [{"interpolation": 0}, {"interpolation": 7}, {"interpolation": 3, "root": "slerp"}])
def test_curves_that_there_are_none_of_are_refused(capture: Capture, changes: dict) -> None:
    with pytest.raises(JobInvalid, match="There is no SIDER"):
        BundleMoCapPlusPlus(**changes).solve(capture)


def test_bundlemocap_has_a_key_every_ten_frames_and_is_smooth_between(capture: Capture) -> None:
    result = BundleMoCap().solve(capture)
    assert result.statistics["windows"] == 4
    assert result.motion is not None
    step = np.diff(result.motion.transl, axis=0)
    inner = np.linalg.norm(np.diff(step[:10], axis=0), axis=-1)
    assert inner.max() < 1e-9


def test_a_capture_without_detections_is_refused(capture: Capture) -> None:
    assert capture.keypoints is not None
    blind = replace(capture.keypoints, confidence=np.zeros_like(capture.keypoints.confidence))
    with pytest.raises(NoDetections, match="Nobody|nobody"):
        BundleMoCapPlusPlus().solve(replace(capture, keypoints=blind))
