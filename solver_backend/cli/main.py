"""Runs one verb: parse, do, report, and return the exit code."""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Callable
from contextlib import redirect_stdout
from typing import Any, TextIO

from solver_backend.cli.arguments import parse
from solver_backend.cli.cancel import Cancellation, cancel_at_end_of, cancel_on_signals, cancelled
from solver_backend.cli.outcome import ForPeople, ForPrograms
from solver_backend.exchange.errors import ExitCode, MocapError, SolverFailed
from solver_backend.exchange.outputs import full_disk
from solver_backend.exchange.verb import check_outputs
from solver_backend.exchange.verbs import VERBS

logger = logging.getLogger("solver_backend")


def main(argv: list[str] | None = None) -> int:
    """Run the command line and return its exit code (see ``ExitCode``).

    Args:
        argv: arguments after the program's name; the process's own if left out.
    """
    argv = sys.argv[1:] if argv is None else argv
    teller = ForPrograms(sys.stdout) if "--json" in argv else ForPeople(sys.stdout)
    try:
        with cancel_on_signals() as cancellation:
            return _run(argv, teller, cancellation)
    except BrokenPipeError:  # whoever read our lines is gone, so nobody waits for the result
        _silence(sys.stdout)
        return ExitCode.CANCELLED
    except SystemExit as done:  # argparse has printed its help or the version
        return int(done.code or 0)


def _run(argv: list[str], teller: ForPeople | ForPrograms, cancellation: Cancellation) -> int:
    """Run one verb; exactly one result or error is reported."""
    try:
        args = parse(argv)
        if args.parent_pipe:
            cancel_at_end_of(sys.stdin.fileno())
        logging.basicConfig(
            level=logging.INFO if args.verbose else logging.WARNING,
            format="%(levelname)s: %(message)s",
            stream=sys.stderr,
        )
        with redirect_stdout(sys.stderr):  # what libraries print must not mix with the result
            verb = VERBS[args.verb]
            check_outputs(verb, args)
            outcome = function_of(verb.name)(args, cancellation.watched(teller.progress))
    except MocapError as error:
        teller.error(error)
        return ExitCode.of(error)
    except BrokenPipeError:
        raise
    except Exception as error:
        named = full_disk(error)
        if named is None and cancellation.asked:  # a library, stopped in its midst, made an error of its own of it
            named = cancelled()
        if named is not None:
            teller.error(named)
            return ExitCode.of(named)
        logger.exception("The solver failed.")
        kind = type(error).__name__
        failed = SolverFailed(f"The solver failed: {kind}: {error}", hint="Please report this with the log above.")
        teller.error(failed)
        return ExitCode.FAILED
    teller.result(outcome)
    return ExitCode.RESULT


def function_of(name: str) -> Callable[..., Any]:
    """Return the function of a verb; imported now, so that a wrong command line is answered at once."""
    return VERBS[name].load("solver_backend.cli")


def _silence(stream: TextIO) -> None:
    """Send what is left in a stream's buffer nowhere; flushing it at exit would fail again."""
    try:
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
    except (OSError, ValueError):
        return
