"""The figures behind the page against NumPy and against counts done by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from solver_backend.report.statistics import (
    detected_share,
    located_share,
    quantile,
    residuals_of,
    share,
)
from tests.support.solved import FRAMES, GAP, bare, solved


@given(seed=st.integers(0, 1000), q=st.floats(0, 1), axis=st.sampled_from([0, 1, 2]))
def test_quantiles_equal_numpys_without_its_warnings(seed, q, axis):
    rng = np.random.default_rng(seed)
    values = rng.normal(size=(4, 5, 6))
    values[rng.uniform(size=values.shape) < 0.4] = np.nan
    found = quantile(values, q, axis)
    with np.errstate(all="ignore"):
        expected = np.apply_along_axis(
            lambda v: np.quantile(v[np.isfinite(v)], q) if np.isfinite(v).any() else np.nan, axis, values
        )
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_residuals_by_camera_keypoint_and_frame():
    residuals = residuals_of(*solved())
    np.testing.assert_allclose(residuals.by_camera, [2.0, 2.0, 9.0, 2.0], atol=1e-6)
    assert np.isnan(residuals.by_camera_and_keypoint[0, :3]).all()
    assert residuals.by_camera_and_keypoint[0, 3] == pytest.approx(2.0)
    assert residuals.median_px == pytest.approx(2.0)
    assert residuals.by_frame(0.5).shape == (FRAMES,)
    assert residuals.by_frame(1.0)[0] == pytest.approx(400.0)


def test_agreement_counts_detections_within_the_solvers_limit():
    residuals = residuals_of(*solved())
    np.testing.assert_allclose(residuals.limit_px, 12.0)
    agreement = residuals.agreement_percent(1)
    assert agreement[0, 5] == pytest.approx(100 * 2 / 3)
    assert np.isnan(agreement[0, 0])
    assert agreement[3].min() == 100.0
    detections = np.isfinite(residuals.error_px).sum()
    assert residuals.agreement_percent((0, 1, 2)) == pytest.approx(100 * (1 - 30 / detections))


def test_without_the_solvers_noise_the_limit_comes_from_the_residuals():
    capture, motion = solved(faults=False)
    motion.provenance.pop("sigma_px")
    np.testing.assert_allclose(residuals_of(capture, motion).limit_px, 6.0 * 2.0 / 1.1774, rtol=1e-6)


def test_what_was_detected_and_what_can_be_placed():
    capture, _ = solved()
    seen, located = detected_share(capture), located_share(capture)
    assert seen.shape == (4, FRAMES)
    assert (seen[1, GAP[0] : GAP[1] + 1] == 0).all()
    assert located[GAP[0] : GAP[1] + 1].max() == 0
    assert located[0] == pytest.approx(16 / 17)
    empty, _ = bare(*solved())
    assert detected_share(empty) is None
    assert located_share(empty) is None


def test_share_of_nothing_is_nan():
    assert np.isnan(share(np.zeros(3, bool), np.zeros(3, bool), 0))
    assert share(np.array([True, True, False]), np.array([True, False, True]), 0) == 50.0
