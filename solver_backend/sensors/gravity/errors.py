"""Named errors of the Γ."""

from __future__ import annotations

from solver_backend.exchange.errors import MocapError


class GammaNotFound(MocapError):
    """No three points are apart as the markers of the Γ are."""

    code = "gamma_not_found"


class GammaInvalid(MocapError):
    """The Γ's edges are too short, too long or too alike."""

    code = "gamma_invalid"
