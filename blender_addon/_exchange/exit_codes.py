"""What an exit code means; a program that starts ours needs nothing else to know how it went."""

from __future__ import annotations

from enum import IntEnum

from .early_signals import CANCELLED
from .errors import Cancelled, CommandLineInvalid, JobInvalid, MocapError, SolverFailed


class ExitCode(IntEnum):
    """How a run ended."""

    RESULT = 0
    """There is a result."""
    USAGE = 2
    """The command line, the job file or a setting is wrong."""
    BAD_INPUT = 3
    """A file is missing, damaged or unusable, the output cannot be written, or a strict solve has warnings."""
    FAILED = 4
    """The solver, or what else does the work, failed."""
    CANCELLED = CANCELLED
    """The user, or a signal, ended the work; nothing was left half-written."""

    @classmethod
    def of(cls, error: MocapError) -> ExitCode:
        """Return the exit code of a named error."""
        if isinstance(error, Cancelled):
            return cls.CANCELLED
        if isinstance(error, SolverFailed):
            return cls.FAILED
        return cls.USAGE if isinstance(error, CommandLineInvalid | JobInvalid) else cls.BAD_INPUT


def describe_exit_codes(bad_input: str, failed: str, more: str = "") -> str:
    """Return the end of a command line's help.

    Args:
        bad_input: what 3 stands for.
        failed: what 4 stands for.
        more: lines below the table.
    """
    return f"""\
exit codes:
  0    there is a result
  2    the command line, the job file or a setting is wrong
  3    {bad_input}
  4    {failed}
  130  cancelled (Ctrl-C or a termination signal); nothing was left half-written
{more}
With --json, standard output carries one JSON object a line: any number of {{"event": "progress", ...}} and then exactly
one {{"event": "result", ...}} or {{"event": "error", "code": ..., "message": ..., "where": ..., "hint": ...}}.
"""
