"""The verb that explains a diagnostic or an error by its code."""

from __future__ import annotations

import argparse
import re

from solver_backend.cli.outcome import Outcome
from solver_backend.exchange import errors
from solver_backend.exchange.diagnostics import DiagnosticEntry, list_refusals, load_table
from solver_backend.exchange.errors import CommandLineInvalid, MocapError
from solver_backend.exchange.progress import Progress
from solver_backend.exchange.verb import suggest

_VALUE = re.compile(r"\{(\w+)[^}]*\}")


def explain(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Explain a code from a report, the panel or ``--json``.

    Raises:
        CommandLineInvalid: no diagnostic and no error has this code. The hint is the nearest one.
    """
    code, table, named = args.code.strip().lower(), load_table(), _errors()
    if code in table:
        return _of_diagnostic(code, table[code])
    if code in named:
        lines = [f"{code}: error", named[code].__doc__ or "", f"Exit code {int(named[code].exit_code)}."]
        return Outcome("\n".join(lines), {"code": code, "severity": "error", "text": named[code].__doc__})
    hint = suggest(code, [*table, *named]) or "Codes are in the report, in --json and in the panel's details."
    raise CommandLineInvalid(f"There is no code {code!r}.", where="explain", hint=hint)


def _errors() -> dict[str, type[MocapError]]:
    found = (value for value in vars(errors).values() if isinstance(value, type) and issubclass(value, MocapError))
    return {kind.code: kind for kind in found if kind.__base__ is MocapError}


def _of_diagnostic(code: str, entry: DiagnosticEntry) -> Outcome:
    lines = [f"{code}: {entry.severity.value} ({entry.group})", _VALUE.sub(r"<\1>", entry.text)]
    for name, words in entry.words.items():
        texts = [_VALUE.sub(r"<\1>", word).strip(" ,:") for word in words.values()]
        lines += [f"  <{name}>: {text}" for text in texts if text]
    lines.append(f"Usual cause: {entry.cause}")
    if entry.remedy:
        lines.append("What to do: " + _VALUE.sub(r"<\1>", entry.remedy))
    if code in list_refusals():
        lines.append(f"If the fault is large, the solve is refused. --accept {code} keeps the result.")
    data = {"severity": entry.severity.value, "text": entry.text, "cause": entry.cause, "remedy": entry.remedy}
    return Outcome("\n".join(lines), {"code": code, **data})
