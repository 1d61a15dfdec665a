"""A run of the solver: its stage, progress, remaining time, log and result."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from .._exchange.errors import Cancelled, ErrorEvent, sentence
from .._exchange.events import what_is_wrong
from .._exchange.plain_text import plain
from ..backend_environment import backend_command, environment_for_child
from ..errors import SolverDied, SolverNotUnderstood
from .child import Line, SolverProcess

_FEW_S = 10.0  # Remaining seconds below which none are shown, and the rounding step. Chosen by hand.
_LOG_LINES = 2000  # Number of lines to keep at the end of a run's log. Chosen by hand.


@dataclass
class Run:
    """A solver process with its progress, log and result, which ``poll`` updates."""

    verb: str  # Verb of the solver's command line.
    process: SolverProcess
    stage: str = "Starting"
    done: int = 0
    total: int = 0
    eta_s: float | None = None  # Remaining seconds in the stage, as reported last.
    log: deque[str] = field(default_factory=lambda: deque(maxlen=_LOG_LINES))
    """Last lines of the process's log, and the times of its stages."""
    result: Any = None
    """Result event (one of ``_exchange.verb_results``) once it has arrived and was checked, or None before that."""
    error: ErrorEvent | None = None  # The error event.
    started: float = field(default_factory=time.monotonic)
    finished: bool = False

    @property
    def share(self) -> float:
        """Completed fraction of the stage, 0 to 1."""
        return min(1.0, self.done / self.total) if self.total > 0 else 0.0

    @property
    def elapsed_s(self) -> float:
        """Seconds since the start of the run."""
        return time.monotonic() - self.started

    @property
    def headline(self) -> str:
        """Stage and remaining time, as text to display."""
        if self.process.cancelling:
            return "Cancelling"
        left = "" if self.eta_s is None or self.eta_s < 1 else f", {_duration(self.eta_s)} left"
        return f"{self.stage}{left}"

    def poll(self) -> bool:
        """Read new lines without blocking. Return whether anything changed."""
        code = self.process.exit_code  # read first, so that everything written before the end is already in the queue
        items = self.process.received()
        for item in items:
            self._take(item)
        if code is None or self.finished or items:
            return bool(items)
        self.finished = True
        if self.result is None and self.error is None:
            self.error = _silent_end(code, cancelled=self.process.cancelling)
        return True

    def cancel(self) -> None:
        """Ask the solver to stop and to remove unfinished files."""
        self.process.cancel()

    def _take(self, item: Line) -> None:
        if isinstance(item, str):
            self.log.append(plain(item, keep="\t"))
            return
        event: Any = item
        kind = event["event"]
        if wrong := what_is_wrong(event, self.verb):
            self._take_nonsense(wrong)
        elif kind == "progress":
            if event["stage"] != self.stage:
                self.log.append(f"{self.elapsed_s:7.1f} s  {event['stage']}")
            self.stage, self.done, self.total = event["stage"], event["done"], event["total"]
            self.eta_s = event.get("eta_s")
        elif kind == "result":
            self.result = event
            self.log.append(f"{self.elapsed_s:7.1f} s  Done")
        elif kind == "error":
            self.error = event
            self.log.append(f"{self.elapsed_s:7.1f} s  {sentence(event)}")

    def _take_nonsense(self, wrong: str) -> None:
        """Store an error about an invalid message, which another program or version may have written."""
        message = f"The solver sent an unknown message: {wrong}."
        hint = "Check whether the chosen Python has another version of the solver. Its messages are in the log."
        self.error = SolverNotUnderstood(message, hint=hint).as_event()
        self.log.append(f"{self.elapsed_s:7.1f} s  {sentence(self.error)}")


def start(verb: str, arguments: Sequence[str], python: Path | None, folder: Path) -> Run:
    """Start the solver. Raise ``SolverMissing`` if the solver or its interpreter is missing."""
    command = [*backend_command(python), verb, *arguments, "--json", "--parent-pipe", "--verbose"]
    return run_of(verb, command, environment_for_child(python), folder)


def run_of(verb: str, command: Sequence[str], environment: Mapping[str, str], folder: Path) -> Run:
    """Start a program that writes the same JSON events as the solver, and return its run."""
    run = Run(verb, SolverProcess(command, environment, folder))
    run.log.append(f"> {' '.join(command)}")
    return run


def start_script(verb: str, script: Path, arguments: Sequence[str], python: Path | None, folder: Path) -> Run:
    """Start a script that does not use the solver, but writes the same JSON events."""
    command = [backend_command(python)[0], "-I", "-X", "utf8", str(script), *arguments]
    return run_of(verb, command, environment_for_child(python), folder)


def _silent_end(code: int, *, cancelled: bool) -> ErrorEvent:
    if cancelled:
        return Cancelled("The work was cancelled.").as_event()
    how = f"it was terminated or ran out of memory (signal {-code})" if code < 0 else f"exit code {code}"
    hint = "Its last messages are in the log. Your scene and earlier takes are untouched."
    return SolverDied(f"The solver stopped without a result: {how}.", hint=hint).as_event()


def _duration(seconds: float) -> str:
    if seconds < _FEW_S:
        return "a few seconds"
    coarse = _FEW_S * round(seconds / _FEW_S)
    return f"about {coarse:.0f} seconds" if seconds < 90 else f"about {round(seconds / 60)} minutes"
