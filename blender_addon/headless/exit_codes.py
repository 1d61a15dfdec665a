"""What the exit code means: the same as the solver's."""

from __future__ import annotations

from .._exchange.errors import BackendMissing, ExitCode, MocapError, describe_exit_codes
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

EPILOG = describe_exit_codes(
    "a file is missing, damaged or unusable, or an output exists or cannot be written",
    "the solver failed, or Blender is missing, cannot render or export here",
    "A batch has the code of its worst take.\n",
)
_BROKEN = (
    RenderFailed, BlenderMissing, BackendMissing, BakeFailed, ExportFailed, ExporterMissing, TakeTooSlow, TakeTooLarge,
    TakeUndoable, EngineMissing, SchedulerMissing, WorkersUnsuitable, BatchTaken, ShotsMissing,
)  # fmt: skip


def exit_code(error: MocapError) -> int:
    """Return the exit code of a named error."""
    if isinstance(error, SolverStopped):
        passed_on = ExitCode.USAGE, ExitCode.BAD_INPUT, ExitCode.CANCELLED
        return error.exit_code if error.exit_code in passed_on else ExitCode.FAILED
    if isinstance(error, BatchInvalid):
        return ExitCode.USAGE
    return ExitCode.FAILED if isinstance(error, _BROKEN) else ExitCode.of(error)
