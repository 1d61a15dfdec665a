"""Solve motions from measurements."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from solver_backend.exchange.solve_settings import SolveSettings
    from solver_backend.fitters.keyframes.frame_range import FrameRange, Pin
    from solver_backend.fitters.pipeline import resolve_range, solve, solve_problem
    from solver_backend.fitters.problem import Problem, Solution

__all__ = ["FrameRange", "Pin", "Problem", "Solution", "SolveSettings", "resolve_range", "solve", "solve_problem"]
_HOMES = {
    "exchange.solve_settings": ("SolveSettings",),
    "fitters.keyframes.frame_range": ("FrameRange", "Pin"),
    "fitters.pipeline": ("resolve_range", "solve", "solve_problem"),
    "fitters.problem": ("Problem", "Solution"),
}
"""Public names by module. The modules are imported on first use, so that settings load quickly."""


def __getattr__(name: str) -> Any:
    for home, names in _HOMES.items():
        if name in names:
            return getattr(import_module(f"solver_backend.{home}"), name)
    raise AttributeError(f"{__name__} has no {name}; it has {', '.join(__all__)}.")
