"""The Geman-McClure penalty and its graduated relaxation."""

from __future__ import annotations

from solver_backend.geometry.arrays import Array


def geman_mcclure(squared: Array, scale: float) -> tuple[Array, Array]:
    """Return penalty and IRLS weight of squared residuals.

    ``rho(r) = s² r² / (r² + s²)``, ``w(r) = rho'(r) / (2 r) = (s² / (r² + s²))²``.

    Args:
        squared: r², any shape, in units of the noise's variance.
        scale: s; residuals far beyond it stop pulling. A large scale is plain least squares, which is what
            graduated non-convexity starts from.

    Reference: Geman and McClure 1987; Yang et al. 2020, "Graduated non-convexity for robust spatial perception".
    """
    share = scale * scale / (squared + scale * scale)
    return squared * share, share * share


def graduated_scales(final: float, start: float, steps: int) -> tuple[float, ...]:
    """Return ``steps`` scales that fall geometrically from ``start`` to ``final``."""
    if steps <= 1:
        return (final,)
    ratio = (final / start) ** (1.0 / (steps - 1))
    return tuple(start * ratio**i for i in range(steps))
