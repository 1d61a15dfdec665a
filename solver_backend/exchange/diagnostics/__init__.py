"""What was found: one value from reader to report, worded once, from one table."""

from __future__ import annotations

from .diagnostic import (
    Diagnostic,
    DiagnosticValues,
    Remedy,
    Where,
    diagnostic,
    merge,
    notes_in,
    read_diagnostics,
    warnings_in,
)
from .entry import DiagnosticEntry, Severity
from .refusal import REFUSALS, refuse_errors
from .summary import summarise
from .table import TABLE
from .wording import frames_text, sentence, word

__all__ = [
    "REFUSALS", "TABLE", "Diagnostic", "DiagnosticEntry", "DiagnosticValues", "Remedy",
    "Severity", "Where", "diagnostic", "frames_text", "merge", "notes_in", "read_diagnostics", "refuse_errors",
    "sentence", "summarise", "warnings_in", "word",
]  # fmt: skip
