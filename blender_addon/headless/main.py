"""Command line of the add-on: run one verb, report its result, and return the exit code."""

from __future__ import annotations

import math
import sys

from .._exchange.command import Report, cancel_at_end_of, cancel_on_signals, name_error
from .._exchange.errors import MocapError
from ..errors import BakeFailed
from .process import own_streams
from .result import CommandResult
from .verb_table import MODULE, run_here
from .verb_table import program as program_called

_INTERVAL_S = 0.2  # Shortest time between two progress lines of a stage, in seconds. Chosen by hand.
_GRACE_S = 5.0  # Seconds that a run may continue after its parent program has ended. Chosen by hand.


def main(arguments: list[str] | None = None, program: str = MODULE) -> int:
    """Run a command line (by default the arguments of this process) and return its exit code."""
    arguments = sys.argv[1:] if arguments is None else arguments
    as_json = "--json" in arguments
    try:
        args = program_called(program).parse(arguments)
    except MocapError as error:
        return Report(sys.stdout, sys.stderr, as_json=as_json).error(error)
    # If an ordinary exception is raised while Blender loads its own add-ons, Blender prints it and continues.
    with own_streams(verbose=args.verbose) as (out, err), cancel_on_signals(KeyboardInterrupt) as cancellation:
        report = Report(out, err, as_json=as_json, interval_s=_INTERVAL_S)
        try:
            if args.parent_pipe:  # after the signal handlers are set, because the pipe may already be closed
                cancel_at_end_of(sys.stdin.fileno(), _GRACE_S)
            result = run_here(args, cancellation.watched(report.progress))
        except BaseException as error:
            return report.error(name_error(error, BakeFailed, f"The {args.verb}", asked=cancellation.asked))
        report.result(result, "\n".join(result["outputs"]), _remarks(result))
    return result.get("exit_code", 0)


def _remarks(result: CommandResult) -> list[str]:
    lines = []
    if "joints_deviation_mm" in result:
        joints_mm, skin_mm = result["joints_deviation_mm"], result["skin_deviation_mm"]
        lines.append(f"Blender agrees with the motion within {joints_mm:.3f} mm (joints) and {skin_mm:.3f} mm (skin)")
    if "hands_and_feet_deviation_mm" in result:
        off_mm, scale = result["hands_and_feet_deviation_mm"], result["scale"]
        within = max(0.1, math.ceil(10 * off_mm) / 10)
        lines.append(f"{result['map']}, scaled by {scale:.3f}; Blender's hands and feet match within {within:.1f} mm")
    lines += [f"note: {note}" for note in result["notes"]]
    return lines + ([result["table"]] if "table" in result else [])
