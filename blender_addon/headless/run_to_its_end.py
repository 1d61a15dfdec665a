"""A child process followed to its end, for programs without an event loop."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from .._exchange.errors import Cancelled, MocapError
from .._exchange.progress import Progress
from ..errors import SolverStopped
from ..solving.run import Run

_POLL_S = 0.05
"""Seconds from one look at the child to the next; chosen by hand."""
_BROKEN = 4
"""Exit code of a solver that ended without one, as ``ExitCode.FAILED``."""


def run_to_its_end(
    run: Run, progress: Progress, stopped: Callable[[int], MocapError | None], called: str = "The solver"
) -> Any:
    """Wait for a child process and return its result event; it has ended however this ends.

    Args:
        run: the process, begun.
        progress: receives what it reports.
        stopped: asked again and again about the process; where it returns an error the process is ended.
        called: who a process that ended without a message was.

    Raises:
        SolverStopped: it ended with an error, or without a word.
        MocapError: what ``stopped`` returned.
        Cancelled: it was cancelled, or this program was interrupted.
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
    raise SolverStopped(event, run.process.exit_code or _BROKEN)
