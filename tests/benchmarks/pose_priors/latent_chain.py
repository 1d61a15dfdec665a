"""Denoising and completion with a variational autoencoder, as Pose-NDF's authors use VPoser for comparison (eq. 9)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.fitters.model.subject import PosedFrames, Subject, pose
from solver_backend.priors.base import PosePrior
from solver_backend.solver.block_tridiagonal import BlockTridiagonal
from solver_backend.solver.levenberg_marquardt import LMSettings, levenberg_marquardt


@dataclass(frozen=True)
class LatentChain:
    """``E = 1/2 Σ_t [1/L Σ_l s |y - o|² + λ_θ |z - z_enc|² + λ_t |z_t - z_{t-1}|²]`` over codes z."""

    subject: Subject
    prior: PosePrior
    root: np.ndarray
    transl: np.ndarray
    observed: np.ndarray
    """(F, L, 3) observed landmarks in metres."""
    seen: np.ndarray
    """(F, L) mask of observed landmarks."""
    encoded: np.ndarray
    """(F, d) codes of the input."""
    pull: float
    smoothness: float

    def solve(self, iterations: int = 15) -> np.ndarray:
        """Return the decoded (F, 21, 3, 3) rotations."""
        found = levenberg_marquardt(
            self.encoded, self.linearise, lambda z, step: z + step.reshape(z.shape),
            LMSettings(max_iterations=iterations, tolerance=1e-5),
        )  # fmt: skip
        return self.prior.decode(found.state)

    def linearise(self, z: np.ndarray) -> tuple[np.ndarray, BlockTridiagonal]:
        """Return the cost and its Gauss-Newton equations."""
        local, by_code = self.prior.decode_with_jacobian(z)
        posed = pose(self.subject, PosedFrames(self.root, local, self.transl), jacobian=True)
        count, num_landmarks = posed.points.shape[:2]
        assert posed.by_rotations is not None
        turns = posed.by_rotations.reshape(count, 3 * num_landmarks, -1)[..., 3:]
        J = turns @ by_code.reshape(count, 63, -1)
        weight = np.repeat(self.seen / num_landmarks, 3, axis=1)[..., None]
        error = (posed.points - self.observed).reshape(count, -1, 1)
        Jt, eye = np.swapaxes(J, 1, 2), np.eye(z.shape[1])
        step = np.diff(z, axis=0)
        nothing = np.zeros_like(z[:1])
        arriving, leaving = np.concatenate([nothing, step]), np.concatenate([step, nothing])
        neighbours = np.full(count, 2.0) - (np.arange(count) == 0) - (np.arange(count) == count - 1)
        own = self.pull + self.smoothness * neighbours
        diagonal = Jt @ (weight * J) + own[:, None, None] * eye
        g = (Jt @ (weight * error))[..., 0]
        g = g + self.pull * (z - self.encoded) + self.smoothness * (arriving - leaving)
        cost = 0.5 * float((weight * error**2).sum() + self.pull * ((z - self.encoded) ** 2).sum())
        cost += 0.5 * self.smoothness * float((step**2).sum())
        upper = np.broadcast_to(-self.smoothness * eye, (count - 1, *eye.shape))
        return np.array([cost]), BlockTridiagonal(diagonal, upper, g)
