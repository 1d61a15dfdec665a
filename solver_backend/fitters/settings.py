"""Settings of a solve; they are declared in ``exchange.solve_settings``."""

from solver_backend.exchange.solve_settings import METHOD_NAMES as METHODS
from solver_backend.exchange.solve_settings import SolveSettings

__all__ = ["METHODS", "SolveSettings"]
