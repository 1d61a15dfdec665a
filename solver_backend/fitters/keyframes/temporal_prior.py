"""What smooths keyframes where the data do not constrain them: bounded acceleration, fading speed."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solver_backend.body.state_layout import CODE, ROOT, TRANSL, StateLayout
from solver_backend.fitters.keyframes.normal_equations import KeyframeNormalEquations
from solver_backend.fitters.model.codes import CODES
from solver_backend.fitters.model.keyframes import Keyframes
from solver_backend.geometry.arrays import Array, array_namespace, constant, identity, zeros
from solver_backend.geometry.rotations import quat_left_tangent

FADING_S = 0.15
"""Where nobody is seen, speeds fade within this time; chosen by hand."""


@dataclass(frozen=True)
class MotionPrior:
    """Gaussian priors on keyframes: ``E = 1/2 sum_k |x_{k-1} - 2 x_k + x_{k+1}|² / s²``.

    Bounded acceleration alone carries speed on through a gap: people would lean ever further and drift off. So between
    unseen keys speed is bounded too, ``1/2 sum_k |x_{k+1} - x_k|² h² / (s tau)²`` with keys h apart: the least of both
    fades as ``exp(-t / tau)`` towards a steady way from one end of the gap to the other.
    """

    spacing_s: float
    """Time between keys."""
    accel_sigma: float = 6.0
    """m/s², of the root's translation."""
    angular_sigma: float = 32.0
    """rad/s², of the root's rotation."""
    latent_sigma: float = 8.0
    """1/s², of each coordinate of the code; recorded motion shows 8 over 0.08 s."""
    unseen: np.ndarray | None = None
    """(K - 1,) bool: between two neighbouring keys nobody is seen; None if everywhere somebody is."""

    @classmethod
    def bounded(cls, spacing_s: float, smoothing: float, unseen: np.ndarray | None) -> MotionPrior:
        """Return the priors with every standard deviation divided by ``smoothing``."""
        prior = cls(spacing_s, unseen=unseen)
        sigmas = (prior.accel_sigma, prior.angular_sigma, prior.latent_sigma)
        accel, angular, latent = (sigma / smoothing for sigma in sigmas)
        return replace(prior, accel_sigma=accel, angular_sigma=angular, latent_sigma=latent)

    def part(self, keys: slice) -> MotionPrior:
        """Return the priors on some of the keys."""
        return self if self.unseen is None else replace(self, unseen=self.unseen[keys.start : keys.stop - 1])

    def cost(self, keys: Keyframes, free: StateLayout) -> Array:
        """Return the energy (K,) at each of these keys: of the differences about it, or from it to the next."""
        xp = array_namespace(keys.z)
        cost = zeros((keys.z.shape[0],), keys.z)
        for _, value, _, sigma in self._smooth_parts(keys, free):
            for stencil, weight in self._stencils(sigma):
                rest, weights = _differences(value, stencil, weight)
                first = (len(stencil) - 1) // 2
                cost[first : first + rest.shape[0]] += 0.5 * weights * xp.sum(rest * rest, axis=1)
        return cost

    def add_to(self, equations: KeyframeNormalEquations, keys: Keyframes) -> None:
        """Add the equations of these keys to those of the data, in place."""
        for name, value, tangents, sigma in self._smooth_parts(keys, equations.layout):
            for stencil, weight in self._stencils(sigma):
                self._add_differences(equations, value, tangents, stencil, weight, equations.layout[name].start)

    def _stencils(self, sigma: float) -> list[tuple[tuple[int, ...], Array | float]]:
        """Return coefficients of what is bounded, and precisions: acceleration, and between unseen keys speed."""
        weight = 1.0 / (sigma * self.spacing_s**2) ** 2
        if self.unseen is None or not self.unseen.any():
            return [((1, -2, 1), weight)]
        return [((1, -2, 1), weight), ((-1, 1), self.unseen * weight * (self.spacing_s / FADING_S) ** 2)]

    def _smooth_parts(self, keys: Keyframes, free: StateLayout) -> list[tuple[str, Array, Array, float]]:
        """Return (block, value (K, n), tangents (K, n, d), sigma) of the free blocks that move smoothly."""
        xp = array_namespace(keys.z)
        eye = identity(3, keys.z)
        placed = [
            (ROOT, keys.quat, quat_left_tangent(keys.quat), 0.5 * self.angular_sigma),
            (TRANSL, keys.transl, xp.broadcast_to(eye, (len(keys.z), 3, 3)), self.accel_sigma),
        ]
        if CODE not in free:
            return placed
        return [(CODE, keys.z, CODES.tangent_basis(keys.z), self.latent_sigma), *placed]

    def _add_differences(
        self, equations: KeyframeNormalEquations, value: Array, tangents: Array, stencil: tuple[int, ...],
        weight: Array | float, first: int,
    ) -> None:  # fmt: skip
        """Add ``1/2 sum_k w_k |sum_i c_i x_{k+i}|²`` with the coefficients c of a stencil."""
        xp, single = array_namespace(value), equations.diagonal.dtype
        rest, weights = _differences(value, stencil, weight)
        count, rounded = rest.shape[0], xp.astype(tangents, single)  # matrices only steer the steps
        parts = [(i, c * rounded[i : count + i]) for i, c in enumerate(stencil)]
        for i, left in parts:
            left_T = xp.permute_dims(left, (0, 2, 1)) * xp.astype(weights, single)[:, None, None]
            gradient = _times(tangents[i : count + i], (stencil[i] * weights)[:, None] * rest)
            for j, right in parts:
                if j >= i:
                    self._scatter(equations, i, j, xp.matmul(left_T, right), first)
            for parity in range(min(2, count)):
                keys = np.arange(i, i + count)[parity::2]
                blocks, column = keys // 2, int(keys[0] % 2) * equations.dof + first
                equations.g[blocks, column : column + gradient.shape[1]] += gradient[parity::2]

    def _scatter(self, equations: KeyframeNormalEquations, i: int, j: int, blocks: Array, first: int) -> None:
        """Add blocks that couple the keys k + i and k + j, k = 0, 1, ..."""
        xp = array_namespace(blocks)
        size = blocks.shape[-1]
        for parity in (0, 1):
            chosen = blocks[parity::2]
            if chosen.shape[0] == 0:
                continue
            rows = np.arange(len(chosen)) * 2 + parity + i
            columns = np.arange(len(chosen)) * 2 + parity + j
            row, column = int(rows[0] % 2) * equations.dof + first, int(columns[0] % 2) * equations.dof + first
            if rows[0] // 2 == columns[0] // 2:
                block = rows // 2
                equations.diagonal[block, row : row + size, column : column + size] += chosen
                if i != j:
                    chosen_T = xp.permute_dims(chosen, (0, 2, 1))
                    equations.diagonal[block, column : column + size, row : row + size] += chosen_T
            else:
                equations.upper[rows // 2, row : row + size, column : column + size] += chosen


def _times(tangents: Array, by_value: Array) -> Array:
    """Return (n, d): derivatives by the tangents (n, v, d) of values from those by the values (n, v)."""
    xp = array_namespace(tangents)
    return xp.matmul(xp.permute_dims(tangents, (0, 2, 1)), by_value[..., None])[..., 0]


def _differences(value: Array, stencil: tuple[int, ...], weight: Array | float) -> tuple[Array, Array]:
    """Return ``sum_i c_i x_{k+i}`` (n, d) of (K, d) values with the coefficients c of a stencil, and weights (n,)."""
    xp = array_namespace(value)
    count = max(0, value.shape[0] - len(stencil) + 1)
    rest = xp.sum(xp.stack([c * value[i : count + i] for i, c in enumerate(stencil)]), axis=0)
    weights = constant(weight, value) * xp.ones_like(value[:count, 0])
    return rest, weights
