"""The unknowns of a prop's motion: where it is in every frame, and how fast it goes there."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solver_backend.geometry.rotations import exp_so3, log_so3

SIZE = 12
"""Unknowns of a frame: small turn θ (rad, ``R ← exp(θ) R``), shift (m), angular velocity (rad/s), velocity (m/s), all
of them along the world's axes."""


@dataclass(frozen=True)
class PropState:
    """F frames of a rigid body, ``x_world = R x + t``."""

    R: np.ndarray
    """(F, 3, 3)."""
    t: np.ndarray
    """(F, 3) metres."""
    spin: np.ndarray
    """(F, 3) angular velocity, rad/s."""
    velocity: np.ndarray
    """(F, 3) m/s."""

    @classmethod
    def of_poses(cls, R: np.ndarray, t: np.ndarray, dt: float) -> PropState:
        """Return the state with the velocities of differences over two frames."""
        before, after = np.maximum(np.arange(len(t)) - 1, 0), np.minimum(np.arange(len(t)) + 1, len(t) - 1)
        step = dt * np.maximum(after - before, 1)[:, None]
        return cls(R, t, turns(R[before], R[after]) / step, (t[after] - t[before]) / step)

    def retract(self, step: np.ndarray) -> PropState:
        """Return the state moved by a (1, 12 F) tangent step."""
        turn, shift, spin, velocity = np.split(step.reshape(-1, SIZE), 4, axis=1)
        R = exp_so3(turn) @ self.R
        return replace(self, R=R, t=self.t + shift, spin=self.spin + spin, velocity=self.velocity + velocity)


def turns(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Return (..., 3) rotation vectors φ with ``exp(φ) before = after``."""
    return log_so3(after @ np.swapaxes(before, -1, -2))
