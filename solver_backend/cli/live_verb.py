"""Run the verb ``live stream``, and write the outputs of live runs."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Callable, Iterable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from solver_backend.cli.live_sources import open_source
from solver_backend.cli.outcome import Outcome
from solver_backend.exchange.command import cancelling_until_held
from solver_backend.exchange.errors import Cancelled, CommandLineInvalid
from solver_backend.exchange.events import LiveLine, event_line
from solver_backend.exchange.json_file import as_plain
from solver_backend.exchange.progress import Progress
from solver_backend.exchange.vmc.sender import SENT, read_address
from solver_backend.io.files import AppendedFile, open_appended
from solver_backend.live.recordings import Recorder
from solver_backend.live.sending import PoseSender, Proportions
from solver_backend.live.session import LiveStatistics


def live(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Stream poses until the source ends. Invalid input does not stop the run."""
    if args.parent_pipe and args.source == "-":
        raise CommandLineInvalid("--parent-pipe cannot be used when the points come from standard input.")
    if args.send is not None:
        read_address(args.send, SENT)
    source = open_source(args, progress)
    with (
        cancelling_until_held() as hold,
        LiveOutput(args, source.proportions, source.recorder, *source.others) as output,
    ):
        output.run(source.lines, hold)
    assert output.statistics is not None
    data = {**output.statistics.summary(), **source.summary(), **output.finish()}
    return Outcome(live_text(args, data), data)


def live_text(args: argparse.Namespace, data: Mapping[str, object]) -> str:
    """Describe the result of a live run as text."""
    return f"{args.verb}: {', '.join(f'{name} {value}' for name, value in data.items())}"


class LiveOutput:
    """Writes the lines, recordings and sent poses of a live run. It is a context manager.

    Args:
        proportions: function that returns the person's layout and rest joints, or None for a run without poses.
        recorders: recorders of this run. The result names the file of the first recorder.
    """

    def __init__(
        self, args: argparse.Namespace, proportions: Proportions | None, *recorders: Recorder[...] | None
    ) -> None:
        self.statistics, self._sender = None, None
        if proportions is not None:
            self.statistics = LiveStatistics()
            if args.send is not None:
                self._sender = PoseSender(read_address(args.send, SENT), proportions)
        self._path, self._recorders = args.lines, recorders
        self._recorder = next(iter(recorders), None)
        self._stack = ExitStack()
        self.stopped = False

    def __enter__(self) -> LiveOutput:
        with ExitStack() as stack:
            for part in (*self._recorders, self._sender):
                if part is not None:
                    stack.enter_context(part)
            self.lines = stack.enter_context(Lines(self._path))
            if self._recorder is not None and self._recorder.recovered is not None:
                message = f"An earlier unfinished recording was saved as {self._recorder.recovered}."
                self.lines.write(event_line("recovered", message))
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *raised: Any) -> None:
        self._stack.__exit__(*raised)

    def run(self, lines: Iterable[LiveLine], hold: Callable[[], None]) -> None:
        """Send and write lines until the source ends or a signal arrives.

        Args:
            hold: called after the last line. It makes this process ignore further signals, so that the recordings are
                written completely.
        """
        try:
            for line in lines if self._sender is None else self._sender.watched(lines):
                if self.statistics is not None:
                    self.statistics.add(line)
                    if "frame" in line:
                        line = {**line, "rate_hz": round(self.statistics.rate_hz, 1)}
                self.lines.write(line)
            hold()
        except Cancelled:  # the usual way to end a live run. Recordings are kept
            self.lines.end_line()
            self.stopped = True

    def finish(self) -> dict[str, object]:
        """Finish the run, and return JSON values, such as the recorded files.

        Raises:
            OutputNotWritable: lines were lost.
        """
        data: dict[str, object] = {"stopped": self.stopped, **recorded(self._recorder)}
        self.lines.require_whole()
        return data if self._sender is None else {**data, **self._sender.summary()}


def recorded(recorder: Recorder[...] | None) -> dict[str, str]:
    """Return the paths of a finished recorder's files, by key.

    The key of this run's recording is ``recorded``, or ``not_recorded`` if it has no frames. ``recovered`` is the
    recording of an earlier run that was killed.
    """
    if recorder is None:
        return {}
    key = "recorded" if recorder.count and recorder.path.exists() else "not_recorded"
    found = {"recovered": recorder.recovered, key: recorder.path}
    return {name: str(path) for name, path in found.items() if path is not None}


class Lines:
    """Writes JSON lines to a file, or to standard output, which is otherwise unused in live runs.

    Each line is written in a single call. A write failure does not stop the run.
    """

    def __init__(self, path: Path | None) -> None:
        self._path = path
        if path is not None:
            self._file = open_appended(path, fresh=False)
            return
        if sys.__stdout__ is None:  # the parent process closed it
            handle = os.open(os.devnull, os.O_WRONLY)
        else:
            sys.__stdout__.flush()
            handle = sys.__stdout__.fileno()
        self._file = AppendedFile(handle, "standard output")

    def write(self, line: Mapping[str, object]) -> None:
        """Write a JSON line. If the disk is full, the line is lost and counted."""
        self._file.append(json.dumps(as_plain(line), allow_nan=False).encode() + b"\n")

    def end_line(self) -> None:
        """Complete a line that a signal may have truncated."""
        self._file.append(b"\n")

    def require_whole(self) -> None:
        """Raise ``OutputNotWritable`` if any line was lost."""
        self._file.require_whole("Free disk space for the --lines file. The --record file is not affected.")

    def __enter__(self) -> Lines:
        return self

    def __exit__(self, *_: object) -> None:
        if self._path is not None:
            self._file.close()
