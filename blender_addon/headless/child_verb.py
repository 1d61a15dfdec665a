"""A verb of this command line in a process of its own: Blender does one thing at a time, and may crash."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from .._exchange.errors import MocapError
from .._exchange.progress import Progress
from ..solving.child import SolverProcess
from ..solving.run import Run
from .command_name import COMMAND
from .run_to_its_end import run_to_its_end

_PACKAGE = Path(__file__).resolve().parents[1]


def run_verb(
    verb: str,
    arguments: Sequence[str],
    progress: Progress,
    stopped: Callable[[], MocapError | None] = lambda: None,
) -> Any:
    """Run a verb to its end and return its result event.

    Args:
        verb: bake, render, export or studio.
        arguments: what follows it.
        progress: receives what it reports.
        stopped: asked again and again; where it returns an error the process is ended.

    Raises:
        SolverStopped, MocapError, Cancelled: see ``run_to_its_end``.
    """
    run = start_verb(verb, arguments, Path.cwd())
    return run_to_its_end(run, progress, lambda pid: stopped(), f"Blender's process ({verb})")


def start_verb(verb: str, arguments: Sequence[str], folder: Path) -> Run:
    """Start a verb and return its run, to be polled.

    Args:
        verb: of this command line.
        arguments: what follows it.
        folder: working folder.

    Raises:
        BackendMissing: it cannot be started.
    """
    command = [*command_line(), verb, *arguments, "--json", "--parent-pipe"]
    run = Run(verb, SolverProcess(command, _environment(), folder))
    run.log.append(f"> {' '.join(command)}")
    return run


def command_line() -> list[str]:
    """Return how this command line is started: by Python, or by the Blender that runs it."""
    blender = getattr(getattr(sys.modules.get("bpy"), "app", None), "binary_path", "")
    if blender:
        return [blender, "--command", COMMAND]
    return [sys.executable, "-m", _PACKAGE.name]


def _environment() -> dict[str, str]:
    known = os.environ.get("PYTHONPATH", "")
    return {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, (str(_PACKAGE.parent), known)))}
