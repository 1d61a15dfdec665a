"""Explain a diagnostic or an error by its code, or list all codes."""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator, Mapping
from importlib import import_module

from solver_backend.cli.outcome import Outcome
from solver_backend.exchange.diagnostics import DiagnosticEntry, list_refusals, load_table
from solver_backend.exchange.errors import CommandLineInvalid, MocapError
from solver_backend.exchange.progress import Progress
from solver_backend.exchange.verb import suggest

_LIKENESS = 0.85  # Smallest similarity of a suggested code. Many codes share words.
_PARTS = (
    "sensors.devices.device", "sensors.wand.gamma", "sensors.wand.views", "synthesis.studio.checked_values",
    "videos.detect.detector", "videos.files.video", "videos.pipeline.layout", "videos.sync.clocks",
)  # fmt: skip
"""Modules outside ``exchange`` that define errors."""
_VALUE = re.compile(r"\{(\w+)[^}]*\}")


def explain(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Explain the code of a diagnostic or an error. Without a code, list all codes.

    Raises:
        CommandLineInvalid: no diagnostic or error has this code. The hint suggests the most similar code.
    """
    table, named = load_table(), list_errors()
    if not args.code:
        return _of_all(table, named)
    code = args.code.strip().lower()
    if code in table:
        return _of_diagnostic(code, table[code])
    if code in named:
        remedy = [f"What to do: {named[code].hint}"] if named[code].hint else []
        lines = [f"{code}: error", named[code].__doc__ or "", *remedy, f"Exit code {int(named[code].exit_code)}."]
        return Outcome("\n".join(lines), {"code": code, "severity": "error", "text": named[code].__doc__})
    hint = suggest(code, [*table, *named], _LIKENESS) or "Add-on errors have no code. Their message is complete."
    raise CommandLineInvalid(f"There is no code {code!r}.", where="explain", hint=hint)


def list_errors() -> dict[str, type[MocapError]]:
    """Return the errors that can end a solver verb, by code."""
    for name in _PARTS:
        import_module(f"solver_backend.{name}")
    kinds = sorted((kind for kind in _kinds(MocapError) if "code" in vars(kind)), key=lambda kind: kind.code)
    return {kind.code: kind for kind in kinds if kind.__module__.startswith("solver_backend.")}


def _kinds(base: type[MocapError]) -> Iterator[type[MocapError]]:
    for kind in base.__subclasses__():
        yield kind
        yield from _kinds(kind)


def _of_all(table: Mapping[str, DiagnosticEntry], named: Mapping[str, type[MocapError]]) -> Outcome:
    lines, group = [], ""
    for code, entry in table.items():
        lines += ["", entry.group] if entry.group != group else []
        about = entry.cause or _VALUE.sub(r"<\1>", entry.text)
        lines.append(f"  {code:<28} {entry.severity.value:<7}  {about}")
        group = entry.group
    lines += ["", "Errors that end a command, with the exit code"]
    lines += [f"  {code:<28} {int(kind.exit_code):<7}  {kind.__doc__}" for code, kind in named.items()]
    rows = [{"code": code, "severity": entry.severity.value, "group": entry.group} for code, entry in table.items()]
    errors = [{"code": code, "severity": "error", "exit_code": int(kind.exit_code)} for code, kind in named.items()]
    return Outcome("\n".join(lines[1:]), {"codes": [*rows, *errors]})


def _of_diagnostic(code: str, entry: DiagnosticEntry) -> Outcome:
    lines = [f"{code}: {entry.severity.value} ({entry.group})", _VALUE.sub(r"<\1>", entry.text)]
    for name, words in entry.words.items():
        texts = [_VALUE.sub(r"<\1>", word).strip(" ,:") for word in words.values()]
        lines += [f"  <{name}>: {text}" for text in texts if text]
    if entry.cause:
        lines.append(f"Usual cause: {entry.cause}")
    if entry.remedy:
        lines.append("What to do: " + _VALUE.sub(r"<\1>", entry.remedy))
    if code in list_refusals():
        lines.append(f"If the fault is large, the solve is rejected. --accept {code} keeps the result.")
    data = {"severity": entry.severity.value, "text": entry.text, "cause": entry.cause, "remedy": entry.remedy}
    return Outcome("\n".join(lines), {"code": code, **data})
