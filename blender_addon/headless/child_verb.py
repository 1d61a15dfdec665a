"""A verb of this command line in a process of its own: Blender does one thing at a time, and may crash."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from .._exchange.errors import Cancelled, MocapError
from .._exchange.progress import Progress
from ..errors import SolverStopped
from ..solving.child import SolverProcess
from ..solving.run import Run

_POLL_S = 0.05
_BROKEN = 4
_PACKAGE = Path(__file__).resolve().parents[1]


def run_verb(
    verb: str,
    arguments: Sequence[str],
    progress: Progress,
    stopped: Callable[[], MocapError | None] = lambda: None,
) -> dict[str, Any]:
    """Run a verb to its end and return its result event.

    Args:
        verb: bake, render or export.
        arguments: what follows it.
        progress: told what it tells.
        stopped: asked again and again; where it returns an error the process is ended.

    Raises:
        SolverStopped: it ended with an error, or without a word.
        MocapError: what ``stopped`` returned.
        Cancelled: it was cancelled.
    """
    run = start_verb(verb, arguments, Path.cwd())
    try:
        while not run.finished:
            if error := stopped():
                run.process.kill()
                raise error
            if not run.poll():
                time.sleep(_POLL_S)
            elif run.total > 0:
                progress(run.stage, run.done, run.total)
    except BaseException:
        run.cancel()
        while not run.finished:
            run.poll()
            time.sleep(_POLL_S)
        raise
    if run.result is not None:
        return run.result
    event = run.error or {}
    if event.get("code") == "cancelled":
        raise Cancelled(event["message"], where=event.get("where", ""))
    if event.get("code") == "solver_died":  # the process, whoever it was
        event = {**event, "message": event["message"].replace("The solver", f"Blender's process ({verb})")}
    raise SolverStopped(event, run.process.exit_code or _BROKEN)


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
        from .blender_command import NAME

        return [blender, "--command", NAME]
    return [sys.executable, "-m", _PACKAGE.name]


def _environment() -> dict[str, str]:
    known = os.environ.get("PYTHONPATH", "")
    return {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, (str(_PACKAGE.parent), known)))}
