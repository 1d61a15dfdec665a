"""Penalise distances of landmarks from measured 3D positions, from the floor and from obstacles."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from solver_backend.geometry.arrays import Array, Rows, array_namespace, astype, constant, identity
from solver_backend.geometry.small_matrices import dot, inverse_symmetric_3x3
from solver_backend.residuals.terms import PointEvidence, Residuals, geman_mcclure


@dataclass(frozen=True)
class PositionTerm(Rows):
    """Term ``E = 1/2 sum_i rho(sqrt(w_i e_i' M_i e_i))`` for landmarks y and measured positions m.

    ``e_i = y_i - m_i``, and rho is Geman-McClure's robust penalty. ``w M`` is the inverse covariance of the noise.
    Isotropic noise has M = 1 and ``w = 1/sigma²``.
    """

    positions: Array  # (F, L, 3) metres, finite, arbitrary where the weight is 0.
    weight: Array  # (F, L) inverse variance in 1/m², the mean over the axes. 0 means not observed.
    metric: Array | None = None  # (F, L, 3, 3) M, symmetric and unitless. None means the identity.

    @classmethod
    def of(cls, positions: np.ndarray, covariance: np.ndarray, like: Array) -> PositionTerm:
        """Build the term from (F, L, 3) positions (NaN where missing) and their (F, L, 3, 3) covariances in m²."""
        seen = np.isfinite(positions).all(-1)
        covariance = np.where(seen[..., None, None], covariance, np.eye(3))
        variance = np.trace(covariance, axis1=-2, axis2=-1) / 3.0
        metric = variance[..., None, None] * inverse_symmetric_3x3(covariance, smallest=0.0)
        positions = np.where(seen[..., None], positions, 0.0)
        return cls(*(constant(part, like) for part in (positions, seen / variance, metric)))

    def __call__(self, points: Array, scale: float) -> PointEvidence:
        """Return the cost at (F, L, 3) world positions with its derivatives."""
        xp = array_namespace(points)
        error = points - self.positions
        whitened = self._by_metric(error)
        penalty, robust = geman_mcclure(self.weight * dot(error, whitened), scale)
        weight = (self.weight * robust)[..., None]
        metric = identity(3, points) if self.metric is None else self.metric
        return PointEvidence(0.5 * xp.sum(penalty, axis=-1), weight * whitened, weight[..., None] * metric)

    def residuals(self, points: Array) -> Residuals:
        """Return the differences between (F, L, 3) positions and the measurements, in metres."""
        xp = array_namespace(points)
        error = points - self.positions
        measured = self.weight > 0
        error = xp.where(measured[..., None], error, xp.zeros_like(error))
        squared = self.weight * dot(error, self._by_metric(error))
        return Residuals(error[None], squared[None], measured[None])

    def leverage(self, points: Array, used: Array) -> Array:
        """Return the leverage (1, F, L), which is 1 for a used landmark because it has only one measurement."""
        return array_namespace(points).astype(used, points.dtype)

    def rescaled(self, variance: Array) -> PositionTerm:
        """Scale the noise variance by a factor that broadcasts with (1, F, L)."""
        return replace(self, weight=(self.weight[None] / variance)[0])

    def _by_metric(self, error: Array) -> Array:
        if self.metric is None:
            return error
        return array_namespace(error).matmul(self.metric, error[..., None])[..., 0]


@dataclass(frozen=True)
class RelativePositionTerm:
    """Term for measured positions that have an unknown common shift t in each frame.

    ``E = 1/2 sum_i c rho(sqrt(e_i' W_i e_i))`` with ``e_i = y_i - m_i - t``, for landmarks y and measured positions m.
    The shift itself has no penalty. It is set to ``t = S⁻¹ Σ_i W_i (y_i - m_i)`` with ``S = Σ_i W_i``, the best shift
    without ``rho``.
    """

    positions: Array  # (F, L, 3) metres, finite everywhere.
    precision: Array  # (F, L, 3, 3) W, 1/m²: inverse covariances, 0 where a point is unknown.
    share: float  # c, the weight of one frame if errors are correlated between frames.

    @classmethod
    def of(cls, positions: np.ndarray, precision: np.ndarray, share: float, like: Array) -> RelativePositionTerm:
        """Build the term, with its arrays converted to the library, data type and device of ``like``."""
        return cls(constant(positions, like), constant(precision, like), share)

    def select(self, frames: Any) -> RelativePositionTerm:
        """Return the term for frames that are selected by indices or a slice."""
        return RelativePositionTerm(self.positions[frames], self.precision[frames], self.share)

    def astype(self, precision: Any) -> RelativePositionTerm:
        """Return the term in the given floating-point precision."""
        return RelativePositionTerm(astype(self.positions, precision), astype(self.precision, precision), self.share)

    def __call__(self, points: Array, scale: float) -> PointEvidence:
        """Return cost and derivatives at positions (F, L, 3). The Hessian is for a fixed shift (``without_shift``)."""
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
        # The shift follows every point, so the common part of the pull is removed.
        total = xp.matmul(inverse, xp.sum(pull, axis=1)[..., None])
        gradient = pull - xp.matmul(self.precision, total[:, None])[..., 0]
        information = self.share * robust[..., None, None] * self.precision
        return PointEvidence(0.5 * self.share * xp.sum(penalty, axis=-1), gradient, information)


def without_shift(across: Array, total: Array) -> Array:
    """Return the (F, n, n) matrices ``Bᵀ S⁻¹ B``, the part of the normal equations that a common shift explains.

    B is ``across`` (F, 3, n), the sum over the points of information times derivative. S is ``total`` (F, 3, 3), the
    sum of the points' information.
    """
    xp = array_namespace(across)
    inverse = inverse_symmetric_3x3(total)
    inverse = xp.where(xp.isfinite(inverse), inverse, xp.zeros_like(inverse))
    return xp.matmul(xp.matrix_transpose(across), xp.matmul(inverse, across))


SIGMA_M = 0.006  # Standard deviation in metres of a planted point, due to skin and shoe. Chosen by hand.


def foot_contact_term(planted: np.ndarray, anchors: np.ndarray, like: Array, sigma_m: float = SIGMA_M) -> PositionTerm:
    """Build the term that keeps planted foot points (F, L) at their anchors (F, L, 3) in metres."""
    return PositionTerm(constant(anchors, like), constant(np.where(planted, 1.0 / sigma_m**2, 0.0), like))


FLOOR_SIGMA_M = 0.01  # Standard deviation below the floor in metres, as skin, shoes and mats give way. Chosen by hand.


@dataclass(frozen=True)
class FloorTerm:
    """Term ``E = 1/2 sum_i (min(z_i, 0) / sigma)²`` for landmarks at heights z above the floor."""

    sigma_m: float = FLOOR_SIGMA_M

    def select(self, frames: Any) -> FloorTerm:
        """Return this term unchanged, because it is the same for all frames."""
        return self

    def astype(self, precision: Any) -> FloorTerm:
        """Return this term unchanged, because it takes its precision from the points."""
        return self

    def __call__(self, points: Array, scale: float) -> PointEvidence:
        """Return the cost at (F, L, 3) positions with its derivatives. The robust scale is ignored."""
        xp = array_namespace(points)
        height = points[..., 2]
        below = xp.where(height < 0, height, xp.zeros_like(height))
        weight = xp.where(height < 0, xp.ones_like(height), xp.zeros_like(height)) / self.sigma_m**2
        up = constant((0.0, 0.0, 1.0), points)
        cost = 0.5 * xp.sum(below * below, axis=-1) / self.sigma_m**2
        gradient = (below / self.sigma_m**2)[..., None] * up
        return PointEvidence(cost, gradient, weight[..., None, None] * (up[:, None] * up[None, :]))


UNBOUNDED = 1e6  # Robust scale in standard deviations that no distance reaches.


@dataclass(frozen=True)
class BindingTerm(PositionTerm):
    """``PositionTerm`` for positions that users prescribe, with a quadratic penalty."""

    def __call__(self, points: Array, scale: float) -> PointEvidence:
        """Return the cost at (F, L, 3) world positions with its derivatives."""
        return super().__call__(points, UNBOUNDED)


DEEPEST = 25.0  # Robust scale of a depth in standard deviations. A point that deep is not behind this surface.


@dataclass(frozen=True)
class SurfaceTerm(Rows):
    """Term ``1/2 sum_i rho(min(n_i' y_i - d_i, 0) / sigma)`` that pushes points y out of an obstacle.

    n and d define the plane of the nearest surface. rho is Geman-McClure's penalty with the scale ``DEEPEST``.
    """

    normals: Array  # (F, S, 3) unit vectors that point out of the obstacle.
    offsets: Array  # (F, S) d, metres.
    precision: Array  # (F, S) 1 / sigma², 1/m².

    def __call__(self, points: Array, scale: float) -> PointEvidence:
        """Return the cost at (F, S, 3) positions with its derivatives. The robust scale is ignored."""
        xp = array_namespace(points)
        height = dot(points, self.normals) - self.offsets
        weight = self.precision * xp.astype(height < 0, height.dtype)
        penalty, robust = geman_mcclure(weight * height * height, DEEPEST)
        weight = weight * robust
        pull = (weight * height)[..., None] * self.normals
        squares = self.normals[..., :, None] * self.normals[..., None, :]
        return PointEvidence(0.5 * xp.sum(penalty, axis=-1), pull, weight[..., None, None] * squares)
