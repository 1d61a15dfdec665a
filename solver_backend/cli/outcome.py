"""Store the result of a verb, both as text for users and as values for programs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

from solver_backend.exchange.diagnostics import Diagnostic, notes_in, sentence, warnings_in
from solver_backend.exchange.verb_results import Remarks

Data = TypeVar("Data", bound=Mapping[str, object], covariant=True)
"""Type of an outcome's data: one of ``exchange.verb_results``, or plain values of any kind."""


@dataclass(frozen=True)
class Outcome(Generic[Data]):
    """The result of a command line verb."""

    text: str  # Text for users, printed to standard output.
    data: Data  # Plain JSON values for programs, sent in the result event.
    summary: tuple[str, ...] = ()
    """Text for users on standard error: all warnings, and a summary in the last line."""

    def written(self, key: str, path: Path) -> Outcome[dict[str, object]]:
        """Return a copy of the outcome that also reports a written file, in the text and as ``data[key]``."""
        return Outcome("\n".join([self.text, *rows("written", path)]), {key: str(path), **self.data}, self.summary)


def rows(word: str, *items: object) -> list[str]:
    """Return one line of text per item, such as a file or a diagnostic. Each line starts with ``word``."""
    return [f"  {word:<11} {sentence(item) if isinstance(item, Diagnostic) else item}" for item in items]


def found_lines(found: Sequence[Diagnostic]) -> list[str]:
    """Return diagnostics as lines of text, warnings first."""
    return rows("warning", *warnings_in(found)) + rows("note", *notes_in(found))


def found_data(found: Sequence[Diagnostic]) -> Remarks:
    """Return diagnostics as JSON values for a result event."""
    return {
        "notes": sentences(notes_in(found)),
        "problems": sentences(warnings_in(found)),
        "diagnostics": [item.as_dict() for item in found],
    }


def findings_data(found: Sequence[Diagnostic]) -> dict[str, object]:
    """Return diagnostics of a calibration or a sensor recording as JSON values for a result event."""
    return {"findings": sentences(found), "diagnostics": [item.as_dict() for item in found]}


def sentences(found: Sequence[Diagnostic]) -> list[str]:
    """Return each diagnostic as one line of text."""
    return [sentence(item) for item in found]
