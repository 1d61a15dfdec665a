"""Distance of landmarks to positions that are known but for where all of them are: a pose without its place."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from solver_backend.geometry.arrays import Array, array_namespace, astype, constant
from solver_backend.geometry.small_matrices import inverse_symmetric_3x3
from solver_backend.residuals.robust import geman_mcclure
from solver_backend.residuals.terms import PointEvidence


@dataclass(frozen=True)
class RelativePositionTerm:
    """``E = 1/2 sum_i c rho(sqrt(e_i' W_i e_i))``, ``e_i = y_i - m_i - t``, with Geman-McClure's rho.

    ``t = S⁻¹ Σ_i W_i (y_i - m_i)``, ``S = Σ_i W_i``, is the shift of all points that suits best: it costs nothing.
    """

    positions: Array
    """(F, L, 3) metres, finite everywhere."""
    precision: Array
    """(F, L, 3, 3) W, 1/m²: inverse covariances; 0 where a point is not known."""
    share: float
    """c: how much one frame counts, where the errors of frames are correlated."""

    @classmethod
    def of(cls, positions: np.ndarray, precision: np.ndarray, share: float, like: Array) -> RelativePositionTerm:
        """Build the term in arrays like ``like``."""
        return cls(constant(positions, like), constant(precision, like), share)

    def select(self, frames: Any) -> RelativePositionTerm:
        """Return the term of the frames at these indices (or of this slice)."""
        return RelativePositionTerm(self.positions[frames], self.precision[frames], self.share)

    def astype(self, precision: Any) -> RelativePositionTerm:
        """Return the term in a precision."""
        return RelativePositionTerm(astype(self.positions, precision), astype(self.precision, precision), self.share)

    def __call__(self, points: Array, scale: float) -> PointEvidence:
        """Return the evidence at (F, L, 3) positions; its gradients add up to zero.

        The information is that of the points without their common shift: see ``without_shift``.
        """
        xp = array_namespace(points)
        off = points - self.positions
        pulled = xp.matmul(self.precision, off[..., None])[..., 0]
        inverse = inverse_symmetric_3x3(xp.sum(self.precision, axis=1))
        inverse = xp.where(xp.isfinite(inverse), inverse, xp.zeros_like(inverse))
        shift = xp.matmul(inverse, xp.sum(pulled, axis=1)[..., None])[..., 0]
        error = off - shift[:, None]
        whitened = xp.matmul(self.precision, error[..., None])[..., 0]
        penalty, robust = geman_mcclure(xp.sum(error * whitened, axis=-1), scale)
        pull = self.share * robust[..., None] * whitened
        # The shift follows every point: what all are pulled by comes off again.
        total = xp.matmul(inverse, xp.sum(pull, axis=1)[..., None])
        gradient = pull - xp.matmul(self.precision, total[:, None])[..., 0]
        information = self.share * robust[..., None, None] * self.precision
        return PointEvidence(0.5 * self.share * xp.sum(penalty, axis=-1), gradient, information)


def without_shift(across: Array, total: Array) -> Array:
    """Return (F, n, n): what a common shift takes off the equations of points, ``Bᵀ S⁻¹ B``.

    Args:
        across: (F, 3, n) B, the points' information times their derivative, summed over the points.
        total: (F, 3, 3) S, the sum of their information.
    """
    xp = array_namespace(across)
    inverse = inverse_symmetric_3x3(total)
    inverse = xp.where(xp.isfinite(inverse), inverse, xp.zeros_like(inverse))
    return xp.matmul(xp.matrix_transpose(across), xp.matmul(inverse, across))
