"""Quantiles that leave out what is not known, beside NumPy's."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from solver_backend.geometry.arrays import quantile


@pytest.mark.parametrize("share", [0.0, 0.05, 0.5, 0.9, 1.0])
@pytest.mark.parametrize("axis", [0, 1, -1, (0, 1), (0, 2)])
@pytest.mark.parametrize("method", ["linear", "lower", "nearest"])
def test_quantiles_are_numpys(share: float, axis: int | tuple[int, ...], method: str) -> None:
    values = np.random.default_rng(0).normal(size=(31, 17, 3))
    values[values > 1.2] = np.nan
    expected = np.nanquantile(values, share, axis=axis, method=method)
    np.testing.assert_allclose(quantile(values, share, axis=axis, method=method), expected, rtol=0, atol=1e-15)
    values[np.isnan(values)] = np.inf
    np.testing.assert_allclose(quantile(values, share, axis=axis, method=method), expected, rtol=0, atol=1e-15)


def test_nothing_known_is_nan_without_a_warning() -> None:
    values = np.full((4, 3), np.nan)
    values[:, 0] = [3.0, 1.0, 2.0, np.nan]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        np.testing.assert_array_equal(quantile(values, 0.5, axis=0), [2.0, np.nan, np.nan])
        assert np.isnan(quantile(np.zeros((0, 2)), 0.5, axis=0)).all()
        assert np.isnan(quantile(np.zeros(0), 0.5, axis=0))
