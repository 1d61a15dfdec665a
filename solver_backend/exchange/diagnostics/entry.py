"""A row of the table of diagnostics."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Severity(StrEnum):
    """How grave a diagnostic is; the value is the name written to files."""

    ERROR = "error"
    """It cannot be: the input is refused."""
    WARNING = "warning"
    """The result may be wrong."""
    NOTE = "note"
    """Worth knowing: what was assumed, measured or corrected."""


@dataclass(frozen=True)
class DiagnosticEntry:
    """What the table knows of one code."""

    severity: Severity
    """Unless who finds it knows better."""
    what: str
    """A sentence without its full stop, with the names of ``Diagnostic.values`` and ``Where`` in braces."""
    cause: str
    """What is usually behind it, for the reference page."""
    advice: str
    """What to do about it; empty where nothing is to be done."""


def warning(what: str, cause: str, advice: str) -> DiagnosticEntry:
    """Return a row of a warning."""
    return DiagnosticEntry(Severity.WARNING, what, cause, advice)


def note(what: str, cause: str, advice: str = "") -> DiagnosticEntry:
    """Return a row of a note."""
    return DiagnosticEntry(Severity.NOTE, what, cause, advice)


def error(what: str, cause: str, advice: str) -> DiagnosticEntry:
    """Return a row of an error."""
    return DiagnosticEntry(Severity.ERROR, what, cause, advice)
