"""The solver run to its end, for programs without an event loop."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from .._exchange.errors import Cancelled, MocapError
from .._exchange.progress import Progress
from ..errors import SolverStopped
from ..solving.run import Run, start

_POLL_S = 0.05
_BROKEN = 4


def run_solver(
    verb: str,
    arguments: Sequence[str],
    progress: Progress,
    *,
    python: Path | None = None,
    folder: Path | None = None,
    over_limit: Callable[[int], MocapError | None] = lambda pid: None,
) -> dict[str, Any]:
    """Run the solver and return its result event.

    Args:
        verb: verb of its command line.
        arguments: what follows the verb.
        progress: told what the solver tells.
        python: interpreter to use; None for this one.
        folder: working folder; None for this program's.
        over_limit: asked again and again about the process; where it returns an error the solver is ended.

    Raises:
        BackendMissing: solver or interpreter are not there.
        SolverStopped: it ended with an error.
        MocapError: what ``over_limit`` returned.
        Cancelled: it was cancelled, or this program was interrupted; the solver has ended then.
    """
    run = start(verb, arguments, python, folder or Path.cwd())
    try:
        while not run.finished:
            if error := over_limit(run.process.pid):
                run.process.kill()
                raise error
            if run.poll():
                _tell(run, progress)
            else:
                time.sleep(_POLL_S)
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
    raise SolverStopped(event, run.process.exit_code or _BROKEN)


def _tell(run: Run, progress: Progress) -> None:
    if run.total > 0:
        progress(run.stage, run.done, run.total)
