"""The pages docs/reference/diagnostics*.md and errors.md, made from the table of diagnostics and the errors."""

from __future__ import annotations

import re

from solver_backend.cli.explain import list_errors
from solver_backend.exchange.diagnostics import DiagnosticEntry, Remedy, list_refusals, load_table

_NOTICE = "<!-- Made by python3 dev.py docs from {source}; edit that. -->"

_HEAD = """# Diagnostics

A diagnostic is a finding of the program: something it noticed while it read a capture, solved it or checked the result.
The console, the report, Blender's panel and `--json` all show the same list of diagnostics.

- An **error** means that the input or the result is refused and no file is written. A solve refuses useless results
  with one of these codes: {refusals}. A small fault with the same code is only a warning. To keep a refused
  result, use the option `--accept CODE` of `solve`, `from-videos` and `batch`, the entry `"accept": ["CODE"]` in the
  `settings` of a [job file](job-file.md), or *Accepted Faults* in the panel.
- A **warning** means that the result may be wrong. `solve` prints one line per warning. If you give `--strict`, or
  `"strict": true` in a job file, a solve with warnings writes no file and ends with exit code 3.
- A **note** is only information. A solve that ends with "OK" may have notes.

With `--json`, each diagnostic is an object with the keys `code`, `severity`, `where`, `values` and `remedy`. The object
`where` can have `file`, `frames` (pairs of first and last frame), `cameras`, `markers`, `joints` and `person`. Here
`remedy` states what the program did: {remedies}. A motion file keeps its diagnostics in `provenance`.

The pages of the groups show the message of each code, its usual cause and what to do. The command
`manifold explain CODE` prints the same text. [Error codes](errors.md) lists the errors that end a command."""

_ERRORS = """# Error codes

An error ends a command. Its message states what happened, where, and what to try. With `--json`, the error also has
one of these codes. `manifold explain CODE` prints the meaning of a code, and `manifold explain` lists all codes.
Findings that do not end a command are [diagnostics](diagnostics.md). See also the
[exit codes](command-line.md#exit-codes-and-json).

| code | exit code | meaning |
|---|---|---|"""

_INTRO = """*Slanted* words are values from your recording. "These frames" are the frames that the message names."""

GROUPS = {entry.group.lower().replace(" ", "-"): entry.group for entry in load_table().values()}
"""Groups of diagnostics by the end of their page's name."""


def diagnostics_page() -> str:
    """Return the page about all diagnostics, with the codes of each group."""
    remedies = ", ".join(f"`{remedy.value}`" for remedy in Remedy)
    head = _HEAD.replace("{remedies}", remedies).replace("{refusals}", ", ".join(f"`{c}`" for c in list_refusals()))
    parts = [
        _NOTICE.format(source="solver_backend/exchange/diagnostics.json"),
        "",
        head,
        "",
        "| group | codes |",
        "|---|---|",
    ]
    for page, group in GROUPS.items():
        codes = [f"[`{code}`](diagnostics-{page}.md#{code})" for code, _ in _entries(group)]
        parts += [f"| [{group}](diagnostics-{page}.md) | {', '.join(codes)} |"]
    return "\n".join([*parts, ""])


def diagnostics_group(page: str) -> str:
    """Return the page of a group, with a heading for each code and every form of its message."""
    parts = [_NOTICE.format(source="solver_backend/exchange/diagnostics.json"), "", f"# {GROUPS[page]}", "", _INTRO]
    for code, entry in _entries(GROUPS[page]):
        first, *others = _forms(entry)
        rows = [(entry.severity.value.title(), first), *(("or", form) for form in others)]
        rows += [("Cause", entry.cause), ("What to do", entry.remedy)]
        lines = [f"| {head} | {_slanted(text)} |" for head, text in rows if text]
        parts += ["", f"## {code}", "", lines[0], "|---|---|", *lines[1:]]
    return "\n".join([*parts, ""])


def errors_page() -> str:
    """Return the page of the errors that end a command."""
    rows = [f"| `{code}` | {int(kind.exit_code)} | {kind.__doc__} |" for code, kind in list_errors().items()]
    return "\n".join([_NOTICE.format(source="the docstrings of the errors"), "", _ERRORS, *rows, ""])


def _forms(entry: DiagnosticEntry) -> list[str]:
    """Return the message once for each named value of its parameter, which has other values if one alone is named."""
    forms = [entry.text]
    for name, words in entry.words.items():
        plain = re.compile(r"\{" + name + r"[^}]*\}")
        named = [plain.sub(lambda _, word=word: word, form) for form in forms for word in words.values()]
        forms = [*forms, *named] if len(words) == 1 else named
    return forms


def _entries(group: str) -> list[tuple[str, DiagnosticEntry]]:
    return sorted((code, entry) for code, entry in load_table().items() if entry.group == group)


def _slanted(text: str) -> str:
    marked = re.sub(r"(?<![`\w-])--[a-z-]+( (on|off|[A-Z=]{5,}))?", r"`\g<0>`", text)
    return re.sub(r"\{(\w+)[^}]*\}", r"*\1*", marked).replace("|", "\\|")
