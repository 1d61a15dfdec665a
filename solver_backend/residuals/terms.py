"""Define terms on landmark positions and poses as quadratic models, summed over views."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol, Self

from solver_backend.geometry.arrays import Array, array_namespace


class FrameTerm(Protocol):
    """A term for F frames."""

    def select(self, frames: Any) -> Self:
        """Return the term for the given frame indices or slice."""
        ...

    def astype(self, precision: Any) -> Self:
        """Return the term in the given floating-point precision."""
        ...


@dataclass(frozen=True)
class PointEvidence:
    """Gauss-Newton model of a term around F x L landmark positions."""

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
        """Append evidence at other positions, which has no shared rows."""
        xp = array_namespace(self.cost)
        gradient = xp.concat([self.gradient, other.gradient], axis=1)
        information = xp.concat([self.information, other.information], axis=1)
        return PointEvidence(self.cost + other.cost, gradient, information, self.shared)


class PointTerm(FrameTerm, Protocol):
    """A term on landmark positions."""

    def __call__(self, points: Array, scale: float) -> PointEvidence:
        """Return the evidence at (F, L, 3) positions. ``scale`` is the robust scale in standard deviations."""
        ...


@dataclass(frozen=True)
class Residuals:
    """Errors of measurements by V views in d dimensions. Markers count as one view."""

    error: Array  # (V, F, L, d) in the measurement's unit, 0 where nothing was measured.
    squared: Array  # (V, F, L) squared length of the error, in noise variances.
    measured: Array  # (V, F, L) bool.

    def inliers(self, scale: float) -> Array:
        """Return a (V, F, L) mask of measurements whose errors are below ``scale`` standard deviations."""
        return self.measured & (self.squared < scale * scale)

    @property
    def deviations(self) -> Array:
        """(V, F, L) lengths of the errors in standard deviations, NaN where nothing was measured."""
        xp = array_namespace(self.squared)
        return xp.where(self.measured, xp.sqrt(self.squared), xp.full_like(self.squared, float("nan")))


class DataTerm(PointTerm, Protocol):
    """A point term for measurements whose noise can be learned."""

    def residuals(self, points: Array) -> Residuals:
        """Return the residuals at (F, L, 3) positions."""
        ...

    def leverage(self, points: Array, used: Array) -> Array:
        """Return the (V, F, L) share of each view's error that enters a point fitted to all used views.

        It is the mean diagonal of the hat matrix: ``h_v = tr(w_v J_v S⁻¹ J_vᵀ) / d`` with ``S = Σ_v w_v J_vᵀ J_v``.
        """
        ...

    def rescaled(self, variance: Array) -> Self:
        """Return the term with the noise variance scaled by a factor that broadcasts with (V, F, L)."""
        ...


@dataclass(frozen=True)
class PoseEvidence:
    """Model of a term around F poses."""

    cost: Array  # (F,).
    gradient: Array  # (F, 3 J) w.r.t. the joints' left tangents, 1/rad.
    factors: Array  # (F, n) input for the term's ``hessian``.


class PoseTerm(FrameTerm, Protocol):
    """A term on poses."""

    def __call__(self, local: Array) -> PoseEvidence:
        """Return the evidence at (F, J, 3, 3) rotations."""
        ...

    def hessian(self, factors: Array) -> Array:
        """Return (F, 3 J, 3 J) positive semidefinite matrices in 1/rad², computed from the factors."""
        ...


def geman_mcclure(squared: Array, scale: float) -> tuple[Array, Array]:
    """Return the penalty ``s² r² / (r² + s²)`` and IRLS weight ``(s² / (r² + s²))²`` for squared residuals.

    Residuals far beyond the scale s have no effect. A large scale gives a plain square, the start of graduated
    non-convexity (Geman and McClure 1987; Yang et al. 2020, "Graduated non-convexity for robust spatial perception").
    """
    share = scale * scale / (squared + scale * scale)
    return squared * share, share * share


def graduated_scales(final: float, start: float, steps: int) -> tuple[float, ...]:
    """Return ``steps`` scales from ``start`` to ``final`` in geometric progression."""
    if steps <= 1:
        return (final,)
    ratio = (final / start) ** (1.0 / (steps - 1))
    return tuple(start * ratio**i for i in range(steps))
