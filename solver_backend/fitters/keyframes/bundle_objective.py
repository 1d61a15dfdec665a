"""What the bundle minimises: the terms of its frames (``fitters.objective``) and the terms over its keyframes.

``E(x) = Σ_f E_frame(x_f) + Σ_t E_t(keys)``, where the frames f are what the curves through the keys make of them:

==================  ==============================  ======================================  =========================
term                file                            penalises                               weight
==================  ==============================  ======================================  =========================
temporal prior      keyframes/temporal_prior        acceleration; speed where nobody is     1 / (sigma spacing²)²
                                                    seen
residual rotations  keyframes/residual_rotation     joints off the prior's manifold, with   1 / sigma²
                                                    heavy tails; bends over three keys
==================  ==============================  ======================================  =========================

The published bundle (thesis eqs. 6.6-6.8) has the reprojection term alone; the others are ours.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from solver_backend.body.state_layout import CODE, ROOT, TRANSL, StateLayout
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters.keyframes.normal_equations import KeyframeNormalEquations, differences
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout
from solver_backend.fitters.model.subject import CODES, FrameObjective, Keyframes
from solver_backend.fitters.problem import Problem
from solver_backend.geometry.arrays import Array, array_namespace, constant, identity, zeros
from solver_backend.geometry.rotations import quat_left_tangent
from solver_backend.residuals.terms import PointTerm, geman_mcclure

FADING_S = 0.15  # Where nobody is seen, speeds fade within this time; chosen by hand.


@dataclass(frozen=True)
class MotionPrior:
    """Gaussian priors on keyframes: ``E = 1/2 sum_k |x_{k-1} - 2 x_k + x_{k+1}|² / s²``.

    Bounded acceleration alone continues the speed through a gap, so people drift off. Between unseen keys, h apart,
    ``1/2 sum_k |x_{k+1} - x_k|² h² / (s tau)²`` bounds speed too: it fades as ``exp(-t / tau)``.
    """

    spacing_s: float  # Time between keys.
    accel_sigma: float = 6.0  # m/s², of the root's translation.
    angular_sigma: float = 32.0  # rad/s², of the root's rotation.
    latent_sigma: float = 8.0  # 1/s², of each coordinate of the code; recorded motion shows 8 over 0.08 s.
    unseen: np.ndarray | None = None
    """(K - 1,) bool: nobody is seen between two neighbouring keys; None if somebody is seen everywhere."""

    @classmethod
    def bounded(cls, spacing_s: float, smoothing: float, unseen: np.ndarray | None) -> MotionPrior:
        """Return the priors with every standard deviation divided by ``smoothing``."""
        accel, angular, latent = (
            cls.accel_sigma / smoothing,
            cls.angular_sigma / smoothing,
            cls.latent_sigma / smoothing,
        )
        return cls(spacing_s, accel, angular, latent, unseen)

    def part(self, keys: slice) -> MotionPrior:
        """Return the priors on a range of keys."""
        return self if self.unseen is None else replace(self, unseen=self.unseen[keys.start : keys.stop - 1])

    def cost(self, keys: Keyframes, free: StateLayout) -> Array:
        """Return the energy (K,) at each key: of the differences around it, or from it to the next."""
        xp = array_namespace(keys.z)
        cost = zeros((keys.z.shape[0],), keys.z)
        for _, value, _, sigma in self._smooth_parts(keys, free):
            for stencil, weight in self._stencils(sigma):
                rest, weights = differences(value, stencil, weight)
                first = (len(stencil) - 1) // 2
                cost[first : first + rest.shape[0]] += 0.5 * weights * xp.sum(rest * rest, axis=1)
        return cost

    def add_to(self, equations: KeyframeNormalEquations, keys: Keyframes) -> None:
        """Add the equations of these keys in place."""
        for name, value, tangents, sigma in self._smooth_parts(keys, equations.layout):
            for stencil, weight in self._stencils(sigma):
                equations.add_differences(value, tangents, stencil, weight, equations.layout[name].start)

    def _stencils(self, sigma: float) -> list[tuple[tuple[int, ...], Array | float]]:
        weight = 1.0 / (sigma * self.spacing_s**2) ** 2
        if self.unseen is None or not self.unseen.any():
            return [((1, -2, 1), weight)]
        return [((1, -2, 1), weight), ((-1, 1), self.unseen * weight * (self.spacing_s / FADING_S) ** 2)]

    def _smooth_parts(self, keys: Keyframes, free: StateLayout) -> list[tuple[str, Array, Array, float]]:
        """Return (block, value (K, n), tangents (K, n, d), sigma) of the free blocks that move smoothly."""
        xp = array_namespace(keys.z)
        placed = [
            (ROOT, keys.quat, quat_left_tangent(keys.quat), 0.5 * self.angular_sigma),
            (TRANSL, keys.transl, xp.broadcast_to(identity(3, keys.z), (len(keys.z), 3, 3)), self.accel_sigma),
        ]
        return [(CODE, keys.z, CODES.tangent_basis(keys.z), self.latent_sigma), *placed] if CODE in free else placed


REACH = 3.0
"""Standard deviations of a joint's angle beyond which the prior's pull hardly grows. On nine takes of unusual bodies 3
reduces point errors by 1.5 %; a bent toe at 9 deviations reaches 44 of 70 degrees instead of 25. 2.5 adds jitter."""
STEADINESS = 0.15
"""Precision of the bend of residual rotations over three keys, relative to a frame's. 0.15 reduces acceleration errors
by 3 % and keeps points 0.7 % nearer than without tails; 0.3 removes the remaining jitter and the gain."""


@dataclass(frozen=True)
class ResidualRotationTerm:
    """``E = n/2 sum_ki c² s / (s + c²) + m/2 sum_ki b²`` of residual rotations ``r_ki = rho_ki / sigma_i``.

    ``s = r_ki²`` has heavy tails: toes move rarely, but far. The bend ``b = r_{k-1,i} - 2 r_ki + r_{k+1,i}`` is the
    motion prior of rotations that codes do not express.

    Reference: Geman and McClure 1987 for the tails.
    """

    sigma: np.ndarray  # (J, 3) radians: error of the prior's reconstructions.
    frames_per_key: float = 1.0
    """n, the number of frames whose evidence a key carries: residual rotations are priors on frames."""
    reach: float = REACH  # c.
    steadiness: float = STEADINESS  # m.
    uncovered: tuple[int, ...] = ()  # Columns of a pose that the prior does not model; other terms hold them.

    def part(self, keys: slice) -> ResidualRotationTerm:
        """Return the term of a range of keys; it is the same for all."""
        return self

    def cost(self, keys: Keyframes, free: StateLayout) -> Array:
        """Return the energy (K,) at each key, including the bend around it."""
        xp, n = array_namespace(keys.z), self.frames_per_key
        scaled = self._scaled(keys)
        penalty, _ = geman_mcclure(scaled * scaled, self.reach)
        cost, bend = 0.5 * n * xp.sum(penalty, axis=1), _bend(scaled)
        cost[1:-1] += 0.5 * self.steadiness * xp.sum(bend * bend, axis=1)
        return cost

    def add_to(self, equations: KeyframeNormalEquations, keys: Keyframes) -> None:
        """Add the equations of these keys in place.

        Keys on both sides of a joint between windows are not coupled; squares bound their product.
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
        """Return residual rotations (K, 3 n) of the covered joints in standard deviations."""
        flat = self._covered(keys.residual)
        return flat / constant(self._covered(self.sigma[None])[0], flat)

    def _covered(self, by_joint: Array) -> Array:
        """Return (K, 3 n) of the n covered joints from (K, J, 3)."""
        if self.uncovered:
            kept = [joint for joint in range(by_joint.shape[1]) if joint not in self.uncovered]
            by_joint = by_joint[:, kept]
        return array_namespace(by_joint).reshape(by_joint, (by_joint.shape[0], -1))


def _bend(values: Array) -> Array:
    return values[:-2] - 2.0 * values[1:-1] + values[2:]


OFF_MANIFOLD = 1.25
"""Factor on the reconstruction error of held-out subjects by which poses may leave the prior's manifold. Chosen on
unusual bodies; 1.5 gains as much again on dance and loses 1 % on exercises."""
KeyTerm = MotionPrior | ResidualRotationTerm  # A term on keyframes.


@dataclass(frozen=True)
class BundleObjective:
    """The terms on F frames and on the keys that define them."""

    frames: FrameObjective
    keys: tuple[KeyTerm, ...] = ()

    def part(self, keys: slice) -> BundleObjective:
        """Return the objective of a range of keys; frames are selected by number."""
        return replace(self, keys=tuple(term.part(keys) for term in self.keys))

    def astype(self, precision: Any) -> BundleObjective:
        """Return the objective with measurements in a precision; terms on keys follow the keys' precision."""
        return replace(self, frames=self.frames.astype(precision))


def bundle_objective(
    problem: Problem,
    layout: KeyframeLayout,
    window: int,
    points: tuple[PointTerm, ...],
    settings: SolveSettings,
    *,
    residuals: bool,
    looseness: float = OFF_MANIFOLD,
) -> BundleObjective:
    """Return the objective of the global method.

    Args:
        window: frames of a window.
        points: data term, and contacts where feet stand.
        residuals: let keys leave the prior's manifold.
        looseness: factor on the prior's error by which joints may leave the manifold.
    """
    spacing = 0.5 * window
    terms: list[KeyTerm] = [
        MotionPrior.bounded(spacing / problem.fps, settings.smoothing, layout.gaps(problem.measurements.seen))
    ]
    if residuals:
        sigma, uncovered = looseness * problem.prior.residual_sigma, problem.prior.uncovered
        terms.append(ResidualRotationTerm(sigma, 0.5 * spacing, uncovered=uncovered))
    added = problem.measurements.terms
    frames = FrameObjective((*points, *added.points), (*problem.pose_terms, *added.poses), added.relative)
    return BundleObjective(frames, tuple(terms))
