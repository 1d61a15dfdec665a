"""Define the interface of objective terms: each returns a quadratic model around positions or poses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol, Self

from solver_backend.geometry.arrays import Array, array_namespace


class FrameTerm(Protocol):
    """Term of the objective with data for F frames."""

    def select(self, frames: Any) -> Self:
        """Return the term for frames that are selected by indices or a slice."""
        ...

    def astype(self, precision: Any) -> Self:
        """Return the term in the given floating-point precision."""
        ...


@dataclass(frozen=True)
class PointEvidence:
    """A term's cost in F frames, and a Gauss-Newton model of the cost around L landmark positions per frame."""

    cost: Array  # (F,) half the robust sum of squares.
    gradient: Array  # (F, L, 3) derivative of the cost w.r.t. each position, 1/m.
    information: Array  # (F, L, 3, 3) Gauss-Newton Hessian, 1/m².
    shared: Array | None = None  # (F, R, L, 3) rows of an error shared by points. The Hessian excludes their squares.

    def __add__(self, other: PointEvidence) -> PointEvidence:
        rows = [evidence.shared for evidence in (self, other) if evidence.shared is not None]
        return PointEvidence(
            self.cost + other.cost,
            self.gradient + other.gradient,
            self.information + other.information,
            array_namespace(*rows).concat(rows, axis=1) if rows else None,
        )

    def beside(self, other: PointEvidence) -> PointEvidence:
        """Append the evidence of other landmarks. The appended evidence must not have ``shared`` errors."""
        xp = array_namespace(self.cost)
        gradient = xp.concat([self.gradient, other.gradient], axis=1)
        information = xp.concat([self.information, other.information], axis=1)
        return PointEvidence(self.cost + other.cost, gradient, information, self.shared)


class PointTerm(FrameTerm, Protocol):
    """Term of the objective that depends on landmark positions."""

    def __call__(self, points: Array, scale: float) -> PointEvidence:
        """Return cost and derivatives at (F, L, 3) positions, for a robust ``scale`` in standard deviations."""
        ...


@dataclass(frozen=True)
class Residuals:
    """Measurement errors of V views in d dimensions (2 for pixels, 3 for markers, which count as one view)."""

    error: Array  # (V, F, L, d) in the measurement's unit, 0 where nothing was measured.
    squared: Array  # (V, F, L) squared length of the error, in noise variances.
    measured: Array  # (V, F, L) bool.

    def inliers(self, scale: float) -> Array:
        """Return a (V, F, L) mask of measurements with errors below ``scale`` standard deviations."""
        return self.measured & (self.squared < scale * scale)

    @property
    def deviations(self) -> Array:
        """(V, F, L) lengths of the errors in standard deviations, NaN where nothing was measured."""
        xp = array_namespace(self.squared)
        return xp.where(self.measured, xp.sqrt(self.squared), xp.full_like(self.squared, float("nan")))


class DataTerm(PointTerm, Protocol):
    """Term that compares landmark positions with measurements, and can learn their noise."""

    def residuals(self, points: Array) -> Residuals:
        """Return the measurement errors for landmarks at (F, L, 3) positions."""
        ...

    def leverage(self, points: Array, used: Array) -> Array:
        """Return the (V, F, L) leverage of each view, the share of its error that enters a point fitted to all views.

        It is the mean diagonal of the hat matrix: ``h_v = tr(w_v J_v S⁻¹ J_vᵀ) / d`` with ``S = Σ_v w_v J_vᵀ J_v``.
        """
        ...

    def rescaled(self, variance: Array) -> Self:
        """Scale the noise variance by a factor that broadcasts with (V, F, L)."""
        ...


@dataclass(frozen=True)
class PoseEvidence:
    """A term's cost at each of F poses, and a quadratic model of the cost around each pose."""

    cost: Array  # (F,).
    gradient: Array  # (F, 3 J) w.r.t. the joints' left tangents, 1/rad.
    factors: Array  # (F, n) input for the term's ``hessian``.


class PoseTerm(FrameTerm, Protocol):
    """Term of the objective that depends on joint rotations."""

    def __call__(self, local: Array) -> PoseEvidence:
        """Return the cost at (F, J, 3, 3) rotations with its derivatives."""
        ...

    def hessian(self, factors: Array) -> Array:
        """Return positive semidefinite Hessians (F, 3 J, 3 J) in 1/rad² from the ``factors`` in ``PoseEvidence``."""
        ...


def geman_mcclure(squared: Array, scale: float) -> tuple[Array, Array]:
    """Return the penalty ``s² r² / (r² + s²)`` and IRLS weight ``(s² / (r² + s²))²`` for squared residuals.

    Residuals far beyond the scale s have no effect. A large scale gives a plain square, the start of graduated
    non-convexity (Geman and McClure 1987; Yang et al. 2020, "Graduated non-convexity for robust spatial perception").
    """
    share = scale * scale / (squared + scale * scale)
    return squared * share, share * share


def graduated_scales(final: float, start: float, steps: int) -> tuple[float, ...]:
    """Return ``steps`` robust scales from ``start`` to ``final`` in geometric progression."""
    if steps <= 1:
        return (final,)
    ratio = (final / start) ** (1.0 / (steps - 1))
    return tuple(start * ratio**i for i in range(steps))
