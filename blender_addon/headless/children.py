"""Run verbs (commands) of the solver or of this command line in child processes."""

from __future__ import annotations

import os
import sys
import time
from argparse import Namespace
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from .._exchange.diagnostics import read_diagnostics, sentence, warnings_in
from .._exchange.errors import Cancelled, MocapError
from .._exchange.progress import Progress
from ..errors import SolverStopped
from ..solving.run import Run, run_of, start
from .blender_command import COMMAND
from .result import CommandResult

_PACKAGE = Path(__file__).resolve().parents[1]
_POLL_S = 0.05
"""Seconds between two checks on a child process. Chosen by hand."""


def pass_on(args: Namespace, progress: Progress, words: Sequence[str] = ()) -> CommandResult:
    """Run the solver verb named ``args.verb``, with the extra arguments ``words`` and the options ``args.rest``."""
    result = run_solver(args.verb, [*words, *args.rest], progress, python=args.python)
    files = ("motion", "report", "subject", "markers_file")
    notes = [*result.get("problems", []), *result.get("notes", [])]
    if "problems" not in result:
        takes = result.get("takes", [result])
        found = [item for take in takes for item in read_diagnostics(take.get("diagnostics"))]
        notes = [sentence(item) for item in warnings_in(found)]
    return result | {"outputs": [result[name] for name in files if result.get(name)], "notes": notes}


def run_solver(
    verb: str,
    arguments: Sequence[str],
    progress: Progress,
    *,
    python: Path | None = None,
    stopped: Callable[[int], MocapError | None] = lambda pid: None,
) -> Any:
    """Run a solver verb in the given Python, or in this process's Python, and return its result event."""
    return run_to_its_end(start(verb, arguments, python, Path.cwd()), progress, stopped)


def run_verb(
    verb: str, arguments: Sequence[str], progress: Progress, stopped: Callable[[], MocapError | None] = lambda: None
) -> Any:
    """Run a verb of this command line in a separate process and return its result event.

    A separate process is needed because Blender does one thing at a time and may crash.
    """
    run = start_verb(verb, arguments, Path.cwd())
    return run_to_its_end(run, progress, lambda pid: stopped(), f"Blender's process ({verb})")


def start_verb(verb: str, arguments: Sequence[str], folder: Path) -> Run:
    """Start a verb of this command line in a working folder, and return its run."""
    command = [*command_line(), verb, *arguments, "--json", "--parent-pipe"]
    known = os.environ.get("PYTHONPATH", "")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, (str(_PACKAGE.parent), known)))}
    return run_of(verb, command, environment, folder)


def command_line() -> list[str]:
    """Return the command that starts this product's command line, with the running Blender or with Python."""
    blender = getattr(getattr(sys.modules.get("bpy"), "app", None), "binary_path", "")
    return [blender, "--command", COMMAND] if blender else [sys.executable, "-m", _PACKAGE.name]


def run_to_its_end(
    run: Run, progress: Progress, stopped: Callable[[int], MocapError | None], called: str = "The solver"
) -> Any:
    """Follow a child process until it ends, and return its result event.

    Args:
        stopped: function called regularly with the process ID. If it returns an error, the process is ended.
        called: name of the process, used in the message if it ends without a result.

    Raises:
        SolverStopped: the process ended with an error, or without a result.
    """
    try:
        while not run.finished:
            if error := stopped(run.process.pid):
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
    event = run.error
    assert event is not None
    if event["code"] == "cancelled":
        raise Cancelled(event["message"], where=event["where"])
    if event["code"] == "solver_died":
        event = event.copy()
        event["message"] = event["message"].replace("The solver", called)
    raise SolverStopped(event, run.process.exit_code or 0)
