"""Sums along few coordinates are NumPy's own, to the bit."""

from __future__ import annotations

import numpy as np
import pytest

from solver_backend.geometry.arrays import replaced
from solver_backend.geometry.small_matrices import all_coordinates, any_coordinate, dot, squared_length, sum_of_rows


@pytest.mark.parametrize("precision", [np.float32, np.float64])
@pytest.mark.parametrize("width", [2, 3, 4, 6])
def test_sums_are_those_of_numpy_to_the_bit(width: int, precision: type) -> None:
    rng = np.random.default_rng(width)
    a, b = (rng.standard_normal((40, 21, width)).astype(precision) for _ in range(2))
    for x, y in ((a, b), (a[:, :, ::-1], b), (np.moveaxis(a, 0, 1), np.moveaxis(b, 0, 1)), (a[:, :1], b)):
        assert dot(x, y).tobytes() == np.sum(x * y, axis=-1).tobytes()
    assert squared_length(a).tobytes() == np.sum(a * a, axis=-1).tobytes()
    assert sum_of_rows(a).tobytes() == np.sum(a, axis=-2).tobytes()
    assert sum_of_rows(np.swapaxes(a, 1, 2)).tobytes() == np.sum(np.swapaxes(a, 1, 2), axis=-2).tobytes()


def test_masks_of_coordinates() -> None:
    mask = np.random.default_rng(0).random((50, 3)) > 0.4
    np.testing.assert_array_equal(all_coordinates(mask), mask.all(-1))
    np.testing.assert_array_equal(any_coordinate(mask), mask.any(-1))


def test_what_is_replaced_is_a_copy() -> None:
    values = np.array([1.0, np.nan, 3.0])
    np.testing.assert_array_equal(replaced(values, np.isnan(values), 0.0), [1.0, 0.0, 3.0])
    assert np.isnan(values[1])
