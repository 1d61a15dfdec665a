"""What a verb hands back, and how it is reported to a person or to a program."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Generic, TextIO, TypeVar

from solver_backend.exchange.diagnostics import Diagnostic, notes_in, sentence, warnings_in
from solver_backend.exchange.errors import MocapError
from solver_backend.exchange.plain_text import plain
from solver_backend.exchange.progress import ConsoleProgress, JsonProgress, Progress
from solver_backend.exchange.verb_results import Remarks

Data = TypeVar("Data", bound=Mapping[str, object], covariant=True)
"""Of an outcome: one of ``exchange.verb_results``, or any plain values."""


@dataclass(frozen=True)
class Outcome(Generic[Data]):
    """The result of a verb."""

    text: str
    """For people; printed to standard output."""
    data: Data
    """For programs: plain JSON values of the result event."""
    summary: tuple[str, ...] = ()
    """For people, on standard error after the text: every warning, and a last line to trust."""


def note_lines(found: Sequence[Diagnostic], fps: float = 0.0) -> list[str]:
    """Return the lines of an outcome's text on the notes among diagnostics."""
    return [f"  note        {sentence(item, fps)}" for item in notes_in(found)]


def found_lines(found: Sequence[Diagnostic]) -> list[str]:
    """Return what was found as lines of the console, warnings first."""
    kinds = (("warning", warnings_in(found)), ("note", notes_in(found)))
    return [f"  {kind:<11} {sentence(item)}" for kind, items in kinds for item in items]


def found_data(found: Sequence[Diagnostic]) -> Remarks:
    """Return what was found as values of JSON."""
    return {
        "notes": [sentence(item) for item in notes_in(found)],
        "problems": [sentence(item) for item in warnings_in(found)],
        "diagnostics": [item.as_dict() for item in found],
    }


def findings_data(found: Sequence[Diagnostic]) -> dict[str, object]:
    """Return diagnostics of cameras as plain JSON values, and as sentences."""
    return {"findings": [sentence(item) for item in found], "diagnostics": [item.as_dict() for item in found]}


class ForPeople:
    """Progress bars and messages on standard error, the result's text on standard output."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self.progress: Progress = ConsoleProgress(sys.stderr)

    def result(self, outcome: Outcome) -> None:
        """Print the result."""
        print(plain(outcome.text, keep="\n"), file=self._stream, flush=True)
        for line in outcome.summary:
            print(plain(line), file=sys.stderr, flush=True)

    def error(self, error: MocapError) -> None:
        """Print what went wrong, where, and what to try."""
        start = "\n" if sys.stderr.isatty() else ""
        where = f"\n  where: {plain(error.where)}" if error.where else ""
        hint = f"\n  try:   {plain(error.hint)}" if error.hint else ""
        print(f"{start}error: {plain(error.message)}{where}{hint}", file=sys.stderr, flush=True)


class ForPrograms:
    """JSON lines on standard output."""

    def __init__(self, stream: TextIO) -> None:
        self._lines = JsonProgress(stream)
        self.progress: Progress = self._lines

    def result(self, outcome: Outcome) -> None:
        """Write the result event."""
        self._lines.event({"event": "result", **outcome.data})

    def error(self, error: MocapError) -> None:
        """Write the error event."""
        self._lines.event(error.as_event())
