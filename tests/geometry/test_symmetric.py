"""Symmetric matrices by their six numbers."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from solver_backend.geometry.small_matrices import inverse_symmetric_3x3, mean_sigma, packed, unpacked


@pytest.mark.parametrize("kind", [np.asarray, torch.as_tensor])
def test_six_numbers_say_a_symmetric_matrix(kind):
    A = np.random.default_rng(0).normal(size=(2, 5, 3, 3))
    A = kind(A @ A.swapaxes(-1, -2))
    np.testing.assert_array_equal(unpacked(packed(A)), A)
    np.testing.assert_allclose(mean_sigma(packed(A)), np.sqrt(np.trace(np.asarray(A), axis1=-2, axis2=-1) / 3))
    np.testing.assert_allclose(np.asarray(inverse_symmetric_3x3(A) @ A), np.broadcast_to(np.eye(3), A.shape), atol=1e-9)
