"""Joints may leave the prior's manifold by a small rotation at each key, as far as the prior's own errors suggest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from array_api_compat import array_namespace

from solver_backend.fitters.keyframes.normal_equations import KeyframeNormalEquations
from solver_backend.fitters.model.keyframes import Keyframes
from solver_backend.geometry.arrays import Array, constant, identity


@dataclass(frozen=True)
class ResidualRotationTerm:
    """``E = n/2 sum_k rho_kᵀ P rho_k`` of the residual rotation vectors rho."""

    sigma: np.ndarray
    """(21, 3) radians: how far the prior's own reconstructions are from true poses; P is diagonal, 1 / sigma²."""
    frames_per_key: float = 1.0
    """n, how many frames' worth of evidence a key carries: residual rotations are priors on frames."""

    def part(self, keys: slice) -> ResidualRotationTerm:
        """Return the term of some of the keys: it is the same for all."""
        return self

    def cost(self, keys: Keyframes) -> Array:
        """Return the energy (K,) at each of these keys."""
        xp = array_namespace(keys.z)
        flat = xp.reshape(keys.residual, (keys.residual.shape[0], -1))
        return 0.5 * xp.sum(self._precision(flat) * flat * flat, axis=1)

    def add_to(self, equations: KeyframeNormalEquations, keys: Keyframes) -> None:
        """Add the equations of these keys to those of the data, in place."""
        xp = array_namespace(keys.z)
        count = keys.z.shape[0]
        flat = xp.reshape(keys.residual, (count, -1))
        size, precision = flat.shape[1], self._precision(flat)
        diagonal = identity(size, flat) * precision
        for parity in (0, 1):
            index = np.arange(parity, count, 2) // 2
            first = parity * equations.dof + equations.dof - size
            equations.diagonal[: len(index), first : first + size, first : first + size] += diagonal
            equations.g[: len(index), first : first + size] += (flat * precision)[parity::2]

    def _precision(self, like: Array) -> Array:
        """Return the (63,) precision of a key's residual rotations."""
        return constant((1.0 / self.sigma.reshape(-1) ** 2) * self.frames_per_key, like)
