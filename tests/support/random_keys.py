"""Keyframes of nobody in particular, near to one another as neighbours are."""

import numpy as np
from scipy.spatial.transform import Rotation

from solver_backend.fitters.model.subject import Keyframes, hemisphere_aligned
from solver_backend.geometry.interpolation import spherical_normalisation


def random_keys(count: int, seed: int = 0) -> Keyframes:
    rng = np.random.default_rng(seed)
    base = rng.normal(size=32)
    quat = Rotation.from_rotvec(np.cumsum(0.3 * rng.normal(size=(count, 3)), 0)).as_quat()[:, [3, 0, 1, 2]]
    z = spherical_normalisation(base + 0.5 * rng.normal(size=(count, 32)))
    return hemisphere_aligned(Keyframes(z, quat, rng.normal(size=(count, 3)), 0.2 * rng.normal(size=(count, 21, 3))))
