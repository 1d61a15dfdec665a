"""The verb that explains a diagnostic or an error by its code."""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator
from importlib import import_module

from solver_backend.cli.outcome import Outcome
from solver_backend.exchange.diagnostics import DiagnosticEntry, list_refusals, load_table
from solver_backend.exchange.errors import CommandLineInvalid, MocapError
from solver_backend.exchange.progress import Progress
from solver_backend.exchange.verb import suggest

_LIKENESS = 0.85  # Of a code to the one that the hint suggests: codes share many words.
_PARTS = (
    "sensors.devices.device", "sensors.wand.gamma", "sensors.wand.views", "synthesis.studio.checked_values",
    "videos.detect.detector", "videos.files.video", "videos.pipeline.layout", "videos.sync.clocks",
)  # fmt: skip
"""Modules with errors of their own."""
_VALUE = re.compile(r"\{(\w+)[^}]*\}")


def explain(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Explain a code from a report, the panel or ``--json``.

    Raises:
        CommandLineInvalid: no diagnostic and no error has this code. The hint is the nearest one.
    """
    code, table = args.code.strip().lower(), load_table()
    if code in table:
        return _of_diagnostic(code, table[code])
    named = _errors()
    if code in named:
        lines = [f"{code}: error", named[code].__doc__ or "", f"Exit code {int(named[code].exit_code)}."]
        return Outcome("\n".join(lines), {"code": code, "severity": "error", "text": named[code].__doc__})
    hint = suggest(code, [*table, *named], _LIKENESS) or "Errors of the add-on have no code. Their message is complete."
    raise CommandLineInvalid(f"There is no code {code!r}.", where="explain", hint=hint)


def _errors() -> dict[str, type[MocapError]]:
    for name in _PARTS:
        import_module(f"solver_backend.{name}")
    return {kind.code: kind for kind in _kinds(MocapError) if "code" in vars(kind)}


def _kinds(base: type[MocapError]) -> Iterator[type[MocapError]]:
    for kind in base.__subclasses__():
        yield kind
        yield from _kinds(kind)


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
