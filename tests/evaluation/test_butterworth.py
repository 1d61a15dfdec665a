"""The yardstick's filter against SciPy and against what a low-pass must do."""

import numpy as np
import pytest

from solver_backend.evaluation.evaluate import bridged, butterworth


def test_filter_equals_scipy():
    signal_module = pytest.importorskip("scipy.signal")
    rng = np.random.default_rng(0)
    signal = np.cumsum(rng.normal(size=(300, 2, 3)), axis=0)
    warped = np.arctan(np.tan(np.pi * 6.0 / 60.0) / (np.sqrt(2.0) - 1.0) ** 0.25) / np.pi
    b, a = signal_module.butter(2, 2 * warped)
    expected = signal_module.filtfilt(b, a, signal, axis=0, padlen=30)
    np.testing.assert_allclose(
        butterworth(signal, 60.0, 6.0)[20:-20], expected[20:-20], atol=1e-4 * np.abs(signal).max()
    )


def test_slow_passes_fast_is_removed():
    time = np.arange(600) / 60.0
    slow, fast = np.sin(2 * np.pi * 0.5 * time), np.sin(2 * np.pi * 20 * time)
    out = butterworth((slow + fast)[:, None], 60.0, 6.0)[:, 0]
    assert np.abs(out - slow)[30:-30].max() < 0.02


def test_half_power_at_the_cutoff():
    time = np.arange(1200) / 60.0
    out = butterworth(np.sin(2 * np.pi * 6 * time)[:, None], 60.0, 6.0)[:, 0]
    assert np.sqrt(2 * (out[200:-200] ** 2).mean()) == pytest.approx(np.sqrt(0.5), abs=0.002)


def test_gaps_are_lines_and_ends_are_held():
    points = np.full((6, 2, 3), np.nan)
    points[1, 0], points[4, 0] = 1.0, 4.0
    filled = bridged(points)
    np.testing.assert_allclose(filled[:, 0, 0], [1, 1, 2, 3, 4, 4])
    assert np.isnan(filled[:, 1]).all()
