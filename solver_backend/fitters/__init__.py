"""From measurements to a motion; the public door: ``solve``, ``resolve_range``, their settings and what they return."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from solver_backend.fitters.keyframes.frame_range import FrameRange, Pin
    from solver_backend.fitters.pipeline import resolve_range, solve, solve_problem
    from solver_backend.fitters.problem import Problem
    from solver_backend.fitters.settings import SolveSettings
    from solver_backend.fitters.solution import Solution

__all__ = ["FrameRange", "Pin", "Problem", "Solution", "SolveSettings", "resolve_range", "solve", "solve_problem"]
_HOMES = {
    "FrameRange": "keyframes.frame_range", "Pin": "keyframes.frame_range", "Problem": "problem", "Solution": "solution",
    "SolveSettings": "settings", "resolve_range": "pipeline", "solve": "pipeline", "solve_problem": "pipeline",
}  # fmt: skip
"""Where each name lives; imported when it is asked for, so that a command line that reads settings starts at once."""


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"{__name__} has no {name}; it has {', '.join(__all__)}.")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
