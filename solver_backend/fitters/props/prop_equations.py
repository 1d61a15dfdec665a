"""The cost of a prop's motion: its markers, and a motion whose acceleration is noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.fitters.props.prop_state import SIZE, PropState, turns
from solver_backend.geometry.rotations import cross, left_jacobian_inverse_so3, skew
from solver_backend.residuals.robust import geman_mcclure
from solver_backend.solver.block_tridiagonal import BlockTridiagonal

RELAXES_S = 0.5
"""Time in which a velocity that nothing measures dies away; a hand's strokes last 0.2 to 1 s."""
TURN_PRECISION = 3.0 / np.pi**2
"""Of a turn of which nothing is known: the variance of an angle between -π and π is π² / 3."""


@dataclass(frozen=True)
class PropEquations:
    """Cost, gradient and Hessian of a prop's motion.

    ``½ Σ ρ(|R_f p_m + t_f - x_fm|² / σ²) + ½ Σ eᵀ Q⁻¹ e + ½ Σ dt (|ω|² / q_R + |v|² / q_t) / τ²`` with, between frames,
    ``e = (log(R_f+1 R_fᵀ) - dt ω_f, t_f+1 - t_f - dt v_f, ω_f+1 - ω_f, v_f+1 - v_f)``, ``Q = [[dt³/3, dt²/2], [dt²/2,
    dt]] q`` and τ = ``RELAXES_S``.

    Reference: Barfoot 2017, "State Estimation for Robotics", section 11.2.3 (white noise on acceleration); Uhlenbeck
    and Ornstein 1930 (velocities that die away).
    """

    points: np.ndarray
    """(F, M, 3) recorded markers, metres, NaN where missing."""
    rest: np.ndarray
    """(M, 3) the markers in the prop's frame, metres."""
    sigma_m: float
    """Standard deviation of a marker per axis."""
    unrest: np.ndarray
    """(F - 1, 2) power densities q of the angular acceleration (rad²/s³) and of the acceleration (m²/s³)."""
    dt: float
    """Seconds between frames."""
    scale: float
    """Standard deviations from which on a marker is doubted."""

    def linearise(self, state: PropState) -> tuple[np.ndarray, BlockTridiagonal]:
        """Return the (1,) cost and the normal equations."""
        cost, diagonal, g = self.of_markers(state)
        e, before, after = self._between(state)
        weight = self._precision()
        weighted = (weight @ e[..., None])[..., 0]
        diagonal[:-1] += np.swapaxes(before, -1, -2) @ weight @ before
        diagonal[1:] += np.swapaxes(after, -1, -2) @ weight @ after
        g[:-1] += np.einsum("fij,fi->fj", before, weighted)
        g[1:] += np.einsum("fij,fi->fj", after, weighted)
        rates = np.concatenate([state.spin, state.velocity], axis=1)
        calm = self.dt / RELAXES_S**2 / np.repeat(np.append(self.unrest, self.unrest[-1:], axis=0), 3, axis=1)
        along = np.arange(SIZE // 2, SIZE)
        diagonal[:, along, along] += calm
        g[:, along] += calm * rates
        diagonal[0, :3, :3] += TURN_PRECISION * np.eye(3)
        upper = np.swapaxes(before, -1, -2) @ weight @ after
        cost += 0.5 * float((e * weighted).sum() + (calm * rates**2).sum())
        return np.array([cost]), BlockTridiagonal(diagonal, upper, g)

    def residuals(self, state: PropState) -> tuple[np.ndarray, np.ndarray]:
        """Return (F, M, 3) errors in metres, zero where nothing is seen, and (F, M, 3) the turned markers."""
        turned = self.rest @ np.swapaxes(state.R, -1, -2)
        return np.nan_to_num(turned + state.t[:, None] - self.points), turned

    def weights(self, error: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return (F, M) robust costs and weights of errors, zero where nothing is seen."""
        seen = np.isfinite(self.points).all(-1)
        cost, weight = geman_mcclure((error**2).sum(-1) / self.sigma_m**2, self.scale)
        return np.where(seen, cost, 0.0), np.where(seen, weight, 0.0)

    def of_markers(self, state: PropState) -> tuple[float, np.ndarray, np.ndarray]:
        """Return the markers' cost, and what they add to the blocks (F, 12, 12) and the gradient (F, 12)."""
        error, turned = self.residuals(state)
        cost, weight = self.weights(error)
        weight = weight / self.sigma_m**2
        lever = skew(turned)
        H, g = np.zeros((len(error), SIZE, SIZE)), np.zeros((len(error), SIZE))
        H[:, :3, :3] = np.einsum("fm,fmki,fmkj->fij", weight, lever, lever)
        H[:, :3, 3:6] = np.einsum("fm,fmij->fij", weight, lever)
        H[:, 3:6, :3] = np.swapaxes(H[:, :3, 3:6], -1, -2)
        H[:, [3, 4, 5], [3, 4, 5]] = weight.sum(axis=1)[:, None]
        g[:, :3] = (weight[..., None] * cross(turned, error)).sum(axis=1)
        g[:, 3:6] = (weight[..., None] * error).sum(axis=1)
        return 0.5 * float(cost.sum()), H, g

    def _between(self, state: PropState) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return errors (F - 1, 12) between frames and their Jacobians by the frame before and the one after."""
        turn = turns(state.R[:-1], state.R[1:])
        e = np.concatenate([
            turn - self.dt * state.spin[:-1], np.diff(state.t, axis=0) - self.dt * state.velocity[:-1],
            np.diff(state.spin, axis=0), np.diff(state.velocity, axis=0),
        ], axis=1)  # fmt: skip
        J = left_jacobian_inverse_so3(turn)
        after = np.tile(np.eye(SIZE), (len(e), 1, 1))
        before = -after
        after[:, :3, :3] = J
        # exp(φ) exp(-θ) changes φ by the right Jacobian's inverse, the left one's transposed.
        before[:, :3, :3] = -np.swapaxes(J, -1, -2)
        half = np.arange(SIZE // 2)
        before[:, half, half + SIZE // 2] = -self.dt
        return e, before, after

    def _precision(self) -> np.ndarray:
        """Return (F - 1, 12, 12) Q⁻¹."""
        dt, half = self.dt, np.arange(SIZE // 2)
        share = 1.0 / np.repeat(self.unrest, 3, axis=1)
        weight = np.zeros((len(share), SIZE, SIZE))
        weight[:, half, half] = 12.0 / dt**3 * share
        weight[:, half, half + SIZE // 2] = weight[:, half + SIZE // 2, half] = -6.0 / dt**2 * share
        weight[:, half + SIZE // 2, half + SIZE // 2] = 4.0 / dt * share
        return weight
