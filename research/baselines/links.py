"""Define terms that link the frames of a sequence: slow joints, slow codes, and low frequencies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from research.baselines.sequence import DOF, STATE, Equations, PosedJoints, States
from solver_backend.body.state_layout import CODE
from solver_backend.fitters.model.subject import PosedFrames, Subject
from solver_backend.geometry.rotations import log_so3


@dataclass(frozen=True)
class SlowJoints:
    """``E = 1/2 Σ_t |(J_{t+1} - J_t) fps / v|²`` over the 24 joints (Arnab et al. 2019, eq. 5, squared)."""

    subject: Subject
    fps: float
    speed_m_s: float  # v in m/s

    def __call__(self, states: States, poses: PosedFrames, d_pose_d_state: np.ndarray) -> Equations:
        """Return the cost and the Gauss-Newton equations."""
        posed = PosedJoints.of(self.subject, poses, d_pose_d_state)
        return first_differences(posed.joints, posed.by_states, (self.fps / self.speed_m_s) ** 2)


@dataclass(frozen=True)
class SlowCodes:
    """Penalise fast codes: ``E = 1/2 Σ_t |(z_{t+1} - z_t) fps / u|² + |(root motion) fps / v|²``.

    The root motion is its rotation and translation between frames. The derivative of ``log(R_{t+1} R_tᵀ)`` is
    approximated by ±I, because neighbouring frames are similar.
    """

    fps: float
    codes_per_s: float  # u in standard deviations of the codes per second.
    root_per_s: float  # v in rad/s and m/s.

    def __call__(self, states: States, poses: PosedFrames, d_pose_d_state: np.ndarray) -> Equations:
        """Return the cost and the Gauss-Newton equations."""
        per_s = np.full(DOF, self.root_per_s)
        per_s[STATE[CODE]] = self.codes_per_s
        weight = per_s**-2.0 * self.fps**2
        turn = log_so3(states.root[1:] @ states.root[:-1].swapaxes(-1, -2))
        step = np.concatenate([np.diff(states.z, axis=0), turn, np.diff(states.transl, axis=0)], axis=1)
        count = len(states.z)
        cost, g, H = np.zeros(count), np.zeros((count, DOF)), np.zeros((count, DOF, DOF))
        cost[1:] = 0.5 * (weight * step**2).sum(-1)
        g[1:] += weight * step
        g[:-1] -= weight * step
        H[1:] += np.diag(weight)
        H[:-1] += np.diag(weight)
        return Equations(cost, H, g, np.broadcast_to(-np.diag(weight), (count - 1, DOF, DOF)))


@dataclass(frozen=True)
class JointTargets:
    """``E = 1/2 Σ_t |J_t - M_t|² / σ²``, which pulls the joints in each frame to target positions."""

    subject: Subject
    targets: np.ndarray  # (F, 72) targets M in metres.
    sigma_m: float

    def __call__(self, states: States, poses: PosedFrames, d_pose_d_state: np.ndarray) -> Equations:
        """Return the cost and the Gauss-Newton equations."""
        posed = PosedJoints.of(self.subject, poses, d_pose_d_state)
        weight, error = self.sigma_m**-2.0, posed.joints - self.targets
        J = posed.by_states
        J_T = J.swapaxes(-1, -2)
        g = weight * (J_T @ error[..., None])[..., 0]
        return Equations(0.5 * weight * (error**2).sum(-1), weight * J_T @ J, g)


def first_differences(values: np.ndarray, J: np.ndarray, weight: float) -> Equations:
    """Return the equations of ``1/2 w Σ_t |x_{t+1} - x_t|²`` for values x (F, m) and derivatives J (F, m, 38)."""
    step, J_T = np.diff(values, axis=0), J.swapaxes(-1, -2)
    cost, by_values = np.zeros(len(values)), np.zeros_like(values)
    cost[1:] = 0.5 * weight * (step**2).sum(-1)
    by_values[1:] += step
    by_values[:-1] -= step
    times = np.full(len(values), 2.0)
    times[0] = times[-1] = 1.0
    H = weight * times[:, None, None] * (J_T @ J)
    return Equations(cost, H, weight * (J_T @ by_values[..., None])[..., 0], -weight * (J_T[:-1] @ J[1:]))


def low_frequencies(values: np.ndarray, segment: int, kept: int) -> np.ndarray:
    """Keep the ``kept`` lowest frequencies of values (F, m) per segment of about ``segment`` frames.

    Reference: Akhter et al. 2008 and Huang et al. 2017, eq. 6 (DCT-II basis).
    """
    parts = np.array_split(values, max(1, round(len(values) / segment)))
    return np.concatenate([_slowest(part, max(2, round(kept * len(part) / segment))) for part in parts])


def _slowest(values: np.ndarray, kept: int) -> np.ndarray:
    count = len(values)
    frequency, time = np.arange(min(kept, count)), np.arange(count) + 0.5
    basis = np.cos(np.pi / count * np.outer(time, frequency)) * np.sqrt(2.0 / count)
    basis[:, 0] /= np.sqrt(2.0)
    return basis @ (basis.T @ values)
