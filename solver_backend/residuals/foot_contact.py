"""Feet that stand, stand: points of a planted foot are drawn to where they have been."""

from __future__ import annotations

import numpy as np

from solver_backend.geometry.arrays import Array, constant
from solver_backend.residuals.positions import PositionTerm

SIGMA_M = 0.006
"""How far a planted point's skin and shoe give; chosen by hand."""


def foot_contact_term(planted: np.ndarray, anchors: np.ndarray, like: Array, sigma_m: float = SIGMA_M) -> PositionTerm:
    """Return ``E = 1/2 sum_i rho(|y_i - a_i| / sigma)`` over the planted points i with their anchors a.

    Args:
        planted: (F, L) bool.
        anchors: (F, L, 3) metres, finite everywhere.
        like: array that sets kind, type and device.
        sigma_m: standard deviation of a planted point.
    """
    return PositionTerm(constant(anchors, like), constant(np.where(planted, 1.0 / sigma_m**2, 0.0), like))
