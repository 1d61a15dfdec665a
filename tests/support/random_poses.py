"""Poses of normally distributed rotation vectors."""

from __future__ import annotations

import numpy as np

from solver_backend.geometry.rotations import exp_so3


def poses(count: int, scale: float = 0.4, seed: int = 0) -> np.ndarray:
    return exp_so3(scale * np.random.default_rng(seed).standard_normal((count, 21, 3)))
