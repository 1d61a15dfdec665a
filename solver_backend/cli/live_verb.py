"""The verb that runs live: points or poses in, poses as lines and to a receiver."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from typing import TYPE_CHECKING

from solver_backend.cli.cancel import cancelling_until_held
from solver_backend.cli.line_output import Lines
from solver_backend.cli.live_sources import open_source
from solver_backend.cli.outcome import Outcome
from solver_backend.exchange.errors import Cancelled, CommandLineInvalid
from solver_backend.exchange.live_lines import LiveLine, event_line
from solver_backend.exchange.progress import Progress
from solver_backend.exchange.vmc.sender import read_address

if TYPE_CHECKING:
    from solver_backend.live.recordings import Recorder
    from solver_backend.live.sending import PoseSender, Proportions
    from solver_backend.live.session_loop import LiveStatistics


def live(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Run until the source ends; nothing that comes in ends it."""
    if args.parent_pipe and args.source == "-":
        raise CommandLineInvalid("--parent-pipe watches standard input, which the points come by.")
    if args.send is not None:
        read_address(args.send)
    from solver_backend.live.session_loop import LiveStatistics

    statistics = LiveStatistics()
    source = open_source(args, progress)
    recorder = source.recorder
    with ExitStack() as stack:
        hold = stack.enter_context(cancelling_until_held())
        for kept in (*((recorder,) if recorder is not None else ()), *source.beside):
            stack.enter_context(kept)
        sender = open_sender(args.send, source.proportions)
        if sender is not None:
            stack.enter_context(sender)
        stream = stack.enter_context(Lines(args.lines))
        report_recovered(recorder, stream)
        stopped = run_lines(source.lines, stream, statistics, sender, hold)
    data: dict[str, object] = {**statistics.summary(), **source.summary(), "stopped": stopped}
    data |= recorded(recorder)
    data |= {} if sender is None else sender.summary()
    stream.require_whole()
    text = ", ".join(f"{name} {value}" for name, value in data.items())
    return Outcome(f"live: {text}", data)


def report_recovered(recorder: Recorder[...] | None, stream: Lines) -> None:
    """Write a line on what a run that was killed has left, and is finished now."""
    if recorder is not None and recorder.recovered is not None:
        message = f"A recording that was not finished is now {recorder.recovered}."
        stream.write(event_line("recovered", message))


def recorded(recorder: Recorder[...] | None) -> dict[str, str]:
    """Return where recordings are: this run's, and one that was finished for a run that was killed.

    ``not_recorded`` names the file of a run in which nothing came that could be recorded.
    """
    if recorder is None:
        return {}
    key = "recorded" if recorder.count and recorder.path.exists() else "not_recorded"
    found = {"recovered": recorder.recovered, key: recorder.path}
    return {name: str(path) for name, path in found.items() if path is not None}


def open_sender(address: str | None, proportions: Proportions) -> PoseSender | None:
    """Return what sends poses to an address of the command line; None where there is none: nothing is sent unasked.

    Raises:
        CommandLineInvalid: it is no address, or there is no such host.
    """
    if address is None:
        return None
    from solver_backend.live.sending import PoseSender

    return PoseSender(read_address(address), proportions)


def run_lines(
    lines: Iterable[LiveLine], stream: Lines, statistics: LiveStatistics | None, sender: PoseSender | None,
    hold: Callable[[], None],
) -> bool:  # fmt: skip
    """Send and write lines until the source ends; return whether somebody stopped it before.

    Args:
        lines: poses and events, or lines of another kind where there are no statistics.
        stream: where they are written.
        statistics: counts them.
        sender: sends the poses.
        hold: lets whoever stops it later wait until the recording is written.
    """
    try:
        for line in lines if sender is None else sender.watched(lines):
            if statistics is not None:
                statistics.add(line)
                if "frame" in line:
                    line = {**line, "rate_hz": round(statistics.rate_hz, 1)}
            stream.write(line)
        hold()
    except Cancelled:  # the usual end of what is live: what was recorded is kept
        stream.end_line()
        return True
    return False
