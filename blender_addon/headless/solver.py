"""The solver run to its end, for programs without an event loop."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from .._exchange.errors import MocapError
from .._exchange.progress import Progress
from ..solving.run import start
from .run_to_its_end import run_to_its_end


def run_solver(
    verb: str,
    arguments: Sequence[str],
    progress: Progress,
    *,
    python: Path | None = None,
    folder: Path | None = None,
    over_limit: Callable[[int], MocapError | None] = lambda pid: None,
) -> Any:
    """Run the solver and return its result event.

    Args:
        verb: verb of its command line.
        arguments: what follows the verb.
        progress: receives what the solver reports.
        python: interpreter to use; None for this one.
        folder: working folder; None for this program's.
        over_limit: asked again and again about the process; where it returns an error the solver is ended.

    Raises:
        BackendMissing: solver or interpreter are not there.
        SolverStopped, MocapError, Cancelled: see ``run_to_its_end``.
    """
    return run_to_its_end(start(verb, arguments, python, folder or Path.cwd()), progress, over_limit)
