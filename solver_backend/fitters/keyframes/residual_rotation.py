"""Joints may leave the prior's manifold by a small rotation at each key, as far as the prior's own errors suggest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from array_api_compat import array_namespace

from solver_backend.body.state_layout import StateLayout
from solver_backend.fitters.keyframes.normal_equations import KeyframeNormalEquations
from solver_backend.fitters.model.keyframes import Keyframes
from solver_backend.geometry.arrays import Array, constant
from solver_backend.residuals.robust import geman_mcclure

REACH = 3.0
"""Deviations of a joint's angle beyond which the prior holds it by little more than there. On nine takes of strange
bodies 3 brings points nearer by 1.5 %, and a bent toe, 9 deviations off, from 25 to 44 degrees of 70; with 2.5 bodies
shiver more."""
STEADINESS = 0.15
"""Precision of how residual rotations bend over three keys, by that of a frame's. With 0.15 acceleration errors fall by
3 % and points stay 0.7 % nearer than without tails; 0.3 takes the rest of the shiver and all that was gained."""


@dataclass(frozen=True)
class ResidualRotationTerm:
    """``E = n/2 sum_ki c² s / (s + c²) + m/2 sum_ki b²`` of residual rotations ``r_ki = rho_ki / sigma_i``.

    ``s = r_ki²`` has heavy tails: toes hardly move in recordings, and where they do they move far. The bend
    ``b = r_{k-1,i} - 2 r_ki + r_{k+1,i}`` is the motion prior of what codes do not move.

    Reference: Geman and McClure 1987 for the tails.
    """

    sigma: np.ndarray
    """(J, 3) radians: how far the prior's own reconstructions are from true poses."""
    frames_per_key: float = 1.0
    """n, how many frames' worth of evidence a key carries: residual rotations are priors on frames."""
    reach: float = REACH
    """c."""
    steadiness: float = STEADINESS
    """m."""
    uncovered: tuple[int, ...] = ()
    """Columns of a pose that the prior does not model: other terms hold them."""

    def part(self, keys: slice) -> ResidualRotationTerm:
        """Return the term of some of the keys: it is the same for all."""
        return self

    def cost(self, keys: Keyframes, free: StateLayout) -> Array:
        """Return the energy (K,) at each of these keys, and of the bend about it."""
        xp, n = array_namespace(keys.z), self.frames_per_key
        scaled = self._scaled(keys)
        penalty, _ = geman_mcclure(scaled * scaled, self.reach)
        cost, bend = 0.5 * n * xp.sum(penalty, axis=1), _bend(scaled)
        cost[1:-1] += 0.5 * self.steadiness * xp.sum(bend * bend, axis=1)
        return cost

    def add_to(self, equations: KeyframeNormalEquations, keys: Keyframes) -> None:
        """Add the equations of these keys to those of the data, in place.

        The keys before and after a window's joint do not meet in the equations: their product is bounded by squares.
        """
        scaled, m = self._scaled(keys), self.steadiness
        _, weight = geman_mcclure(scaled * scaled, self.reach)
        precision, bend = self.frames_per_key * weight, m * _bend(scaled)
        gradient = precision * scaled
        for shift, factor in enumerate((1.0, -2.0, 1.0)):
            gradient[shift : len(bend) + shift] += factor * bend
        precision[:-2:2] += m  # about a window's middle key
        precision[1:-1:2] += 4.0 * m
        precision[2::2] += m
        precision[1:-3:2] += 2.0 * m  # about a joint of windows
        precision[2:-2:2] += 4.0 * m
        precision[3::2] += 2.0 * m
        by_angle = 1.0 / constant(self._covered(self.sigma[None])[0], scaled)
        precision, gradient = precision * by_angle**2, gradient * by_angle
        count, size = precision.shape
        even = np.arange(equations.dof - size, equations.dof)
        odd = even + equations.dof
        equations.add_own(even, precision, gradient)
        unit, windows = m * by_angle**2, (count - 1) // 2
        equations.upper[:windows, even, even] += unit
        for inner in (slice(0, windows), slice(1, windows)):  # about middle keys, about joints
            equations.diagonal[inner, even, odd] -= 2.0 * unit
            equations.diagonal[inner, odd, even] -= 2.0 * unit
        equations.upper[:windows, odd, even] -= 2.0 * unit
        equations.upper[: windows - 1, odd, even] -= 2.0 * unit

    def _scaled(self, keys: Keyframes) -> Array:
        """Return residual rotations (K, 3 n) of the covered joints in deviations."""
        flat = self._covered(keys.residual)
        return flat / constant(self._covered(self.sigma[None])[0], flat)

    def _covered(self, by_joint: Array) -> Array:
        """Return (K, 3 n) of the n covered joints from (K, J, 3)."""
        if self.uncovered:
            kept = [joint for joint in range(by_joint.shape[1]) if joint not in self.uncovered]
            by_joint = by_joint[:, kept]
        return array_namespace(by_joint).reshape(by_joint, (by_joint.shape[0], -1))


def _bend(values: Array) -> Array:
    """Return ``x_{k-1} - 2 x_k + x_{k+1}``, (K - 2, n)."""
    return values[:-2] - 2.0 * values[1:-1] + values[2:]
