"""The command line of the solver, and the settings that stand on it."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from typing import Any

from solver_backend.exchange.errors import describe_exit_codes
from solver_backend.exchange.reading_settings import ROWS as READING_ROWS
from solver_backend.exchange.reading_settings import WorldSettings
from solver_backend.exchange.setting import is_list, settings_of_class
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.exchange.verb import Program
from solver_backend.exchange.verbs import SHARED, VERBS
from solver_backend.exchange.version import VERSION

PROGRAM = Program(
    "python -m solver_backend",
    "Turns multi-view keypoints or optical markers into the motion of an SMPL-type body.",
    VERBS,
    SHARED["COMMON"],
    describe_exit_codes(
        "a file is missing, damaged or unusable, the output cannot be written, or a solve with --strict has warnings",
        "the solver failed",
    )
    + "Messages for people go to standard error.",
    f"Manifold MoCap {VERSION}",
)


def parse(argv: list[str]) -> argparse.Namespace:
    """Return the parsed command line; see ``Program.parse``."""
    return PROGRAM.parse(argv)


def given_settings(args: argparse.Namespace) -> dict[str, Any]:
    """Return the settings of a solve that stand on a command line, by name."""
    return _given(args, settings_of_class(SolveSettings))


def given_reading(args: argparse.Namespace) -> dict[str, Any]:
    """Return the settings of how a capture is read that stand on a command line, by name."""
    return {name: tuple(value) if is_list(value) else value for name, value in _given(args, READING_ROWS).items()}


def given_world(args: argparse.Namespace) -> dict[str, Any]:
    """Return the settings of the world that stand on a command line, by name."""
    return _given(args, settings_of_class(WorldSettings))


def _given(args: argparse.Namespace, rows: Iterable[str]) -> dict[str, Any]:
    values = {name: getattr(args, name, None) for name in rows}
    return {name: value for name, value in values.items() if value is not None}
