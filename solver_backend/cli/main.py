"""Runs one verb: parse, do, report, and return the exit code."""

from __future__ import annotations

import argparse
import importlib
import logging
import os
import sys
from collections.abc import Callable
from contextlib import redirect_stdout
from typing import TextIO

from solver_backend.cli.arguments import parse
from solver_backend.cli.camera_live_verb import CAMERA_LIVE_VERBS
from solver_backend.cli.camera_verbs import CAMERA_VERBS
from solver_backend.cli.cancel import Cancellation, cancel_at_end_of, cancel_on_signals
from solver_backend.cli.exit_codes import ExitCode
from solver_backend.cli.marker_verbs import MARKER_VERBS
from solver_backend.cli.motion_verbs import MOTION_VERBS
from solver_backend.cli.oak_verbs import OAK_VERBS
from solver_backend.cli.outcome import ForPeople, ForPrograms, Outcome
from solver_backend.cli.pose_arguments import POSE_VERBS
from solver_backend.cli.prop_verbs import PROP_VERBS
from solver_backend.cli.rig_live_verb import RIG_LIVE_VERBS
from solver_backend.cli.sensor_verbs import SENSOR_VERBS
from solver_backend.cli.studio_verbs import STUDIO_VERBS
from solver_backend.cli.video_arguments import VIDEO_VERBS
from solver_backend.cli.wand_verbs import WAND_VERBS
from solver_backend.exchange.errors import MocapError, SolverFailed
from solver_backend.exchange.outputs import full_disk
from solver_backend.exchange.progress import Progress

logger = logging.getLogger("solver_backend")

Verb = Callable[[argparse.Namespace, Progress], Outcome]


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
            outcome = _verb(args.verb)(args, cancellation.watched(teller.progress))
    except MocapError as error:
        teller.error(error)
        return ExitCode.of(error)
    except BrokenPipeError:
        raise
    except Exception as error:
        if (named := full_disk(error)) is not None:
            teller.error(named)
            return ExitCode.of(named)
        logger.exception("The solver broke.")
        kind = type(error).__name__
        failed = SolverFailed(f"The solver broke: {kind}: {error}", hint="Please report this with the log above.")
        teller.error(failed)
        return ExitCode.FAILED
    teller.result(outcome)
    return ExitCode.RESULT


def _verb(name: str) -> Verb:
    """Return the function of a verb; imported now, so that a wrong command line is answered at once."""
    groups = {
        "pose_verbs": POSE_VERBS, "marker_verbs": MARKER_VERBS, "camera_verbs": CAMERA_VERBS,
        "studio_verbs": STUDIO_VERBS, "video_verbs": VIDEO_VERBS, "solve_verb": ("solve",),
        "sensor_verbs": SENSOR_VERBS, "rig_live_verb": RIG_LIVE_VERBS, "wand_verbs": WAND_VERBS, "oak_verbs": OAK_VERBS,
        "motion_verbs": MOTION_VERBS, "prop_verbs": PROP_VERBS, "camera_live_verb": CAMERA_LIVE_VERBS,
    }  # fmt: skip
    module = next((module for module, names in groups.items() if name in names), "verbs")
    verbs = importlib.import_module(f"solver_backend.cli.{module}")
    return getattr(verbs, name.replace("-", "_"))


def _silence(stream: TextIO) -> None:
    """Send what is left in a stream's buffer nowhere; flushing it at exit would fail again."""
    try:
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
    except (OSError, ValueError):
        return
