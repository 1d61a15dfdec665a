"""What the exit code means: the same as the solver's."""

from __future__ import annotations

from .._exchange.errors import BackendMissing, Cancelled, MocapError
from ..errors import (
    BakeFailed,
    BatchInvalid,
    BatchTaken,
    BlenderMissing,
    EngineMissing,
    ExporterMissing,
    ExportFailed,
    RenderFailed,
    SchedulerMissing,
    ShotsMissing,
    SolverStopped,
    TakeTooLarge,
    TakeTooSlow,
    TakeUndoable,
    WorkersUnsuitable,
)

BROKEN = 4
"""Exit code of a failure that nobody foresaw, as ``ExitCode.FAILED`` of the solver."""
EPILOG = """\
exit codes:
  0    there is a result
  2    the command line, the job file or a setting is wrong
  3    a file is missing, damaged or unusable, or an output exists or cannot be written
  4    the solver failed, or Blender is missing, cannot render or export here
  130  cancelled (Ctrl-C or a termination signal); nothing was left half-written
A batch has the code of its worst take.

With --json, standard output carries one JSON object a line: any number of {"event": "progress", ...} and then exactly
one {"event": "result", ...} or {"event": "error", "code": ..., "message": ..., "where": ..., "hint": ...}.
"""
_BROKEN = (
    RenderFailed, BlenderMissing, BackendMissing, BakeFailed, ExportFailed, ExporterMissing, TakeTooSlow, TakeTooLarge,
    TakeUndoable, EngineMissing, SchedulerMissing, WorkersUnsuitable, BatchTaken, ShotsMissing,
)  # fmt: skip


def exit_code(error: MocapError) -> int:
    """Return the exit code of a named error."""
    if isinstance(error, SolverStopped):
        return error.exit_code if error.exit_code in (2, 3, 130) else BROKEN
    if isinstance(error, Cancelled):
        return 130
    if isinstance(error, BatchInvalid):
        return 2
    return BROKEN if isinstance(error, _BROKEN) else 3
