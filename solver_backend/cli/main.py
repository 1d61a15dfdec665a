"""Run the solver's command line: execute one verb, report the result, and return the exit code."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from contextlib import redirect_stdout
from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, TextIO

from solver_backend.cli.program import PROGRAM, parse
from solver_backend.exchange.command import (
    Cancellation,
    LenientStream,
    Report,
    cancel_at_end_of,
    cancel_on_signals,
    name_error,
    open_standard_streams,
)
from solver_backend.exchange.errors import CommandLineInvalid, ExitCode, MocapError, OutputNotWritable, SolverFailed
from solver_backend.exchange.plain_text import plain
from solver_backend.exchange.progress import Progress
from solver_backend.exchange.verb import check_outputs
from solver_backend.exchange.verbs import VERBS

if TYPE_CHECKING:
    from solver_backend.cli.outcome import Outcome


def main(argv: list[str] | None = None) -> int:
    """Run a command line and return the exit code. By default, run the arguments of this process."""
    argv = sys.argv[1:] if argv is None else argv
    open_standard_streams()
    report = Report(sys.stdout, sys.stderr, as_json="--json" in argv)
    try:
        if argv[:1] == ["blender"]:
            return _run_blender_half(argv[1:], report)
        with cancel_on_signals() as cancellation:
            try:
                outcome = _run(argv, report.progress, cancellation)
            except BrokenPipeError:
                raise
            except Exception as error:
                named = name_error(error, SolverFailed, "The solver", asked=cancellation.asked)
            else:
                return _show(report, outcome)
            try:
                return report.error(named)
            except BrokenPipeError:
                raise
            except OSError:
                return _report_as_text(named)
    except BrokenPipeError:  # whoever read our lines has ended, so nothing waits for the result
        _silence(sys.stdout)
        return ExitCode.CANCELLED
    except SystemExit as done:  # argparse has printed help or the version
        return int(done.code or 0)


def _run_blender_half(argv: list[str], report: Report) -> int:
    """Run the add-on's command line as a separate program, and return its exit code."""
    if find_spec("blender_addon") is None:
        hint = "Run it with the blender_addon package, or inside Blender: blender --command manifold_mocap"
        return report.error(
            CommandLineInvalid(
                "This verb needs the Blender add-on, which is not installed here.", where="blender", hint=hint
            )
        )
    code = import_module("blender_addon.headless.main").main(argv, f"{PROGRAM.name} blender")
    return import_module("blender_addon.headless.process").leave(code)


def _show(report: Report, outcome: Outcome) -> int:
    try:
        report.result(outcome.data, outcome.text, map(plain, outcome.summary))
    except BrokenPipeError:
        raise
    except OSError as error:
        message = f"The result could not be printed: {error.strerror}. Files were written."
        return _report_as_text(OutputNotWritable(message, where="standard output"))
    return ExitCode.RESULT


def _report_as_text(error: MocapError) -> int:
    """Report an error as text on standard error, if standard output cannot be written."""
    _silence(sys.stdout)
    return Report(sys.stderr, sys.stderr, as_json=False).error(error)


def _run(argv: list[str], progress: Progress, cancellation: Cancellation) -> Outcome:
    args = parse(argv)
    import logging  # not needed for printing help

    if args.parent_pipe:
        cancel_at_end_of(sys.stdin.fileno())
    err: Any = LenientStream(sys.stderr)
    level = logging.INFO if args.verbose else logging.WARNING
    logging.basicConfig(level=level, format="%(levelname)s: %(message)s", stream=err)
    with redirect_stdout(err):  # anything that libraries print must not mix with the result
        verb = VERBS[args.verb]
        check_outputs(verb, args)
        outcome = function_of(args.verb)(args, cancellation.watched(progress))
        return outcome.written(verb.writes, args.out) if verb.writes else outcome


def function_of(name: str) -> Callable[..., Any]:
    """Import the function that runs a verb."""
    return VERBS[name].load("solver_backend.cli")


def _silence(stream: TextIO) -> None:
    """Discard the rest of a stream's buffer, because flushing it at exit would fail again."""
    try:
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
    except (OSError, ValueError):
        return
