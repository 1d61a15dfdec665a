"""Generate docs/reference/diagnostics*.md and errors.md from the diagnostics table and the error classes."""

from __future__ import annotations

import re

from solver_backend.cli.explain import list_errors
from solver_backend.exchange.diagnostics import DiagnosticEntry, Remedy, Severity, list_refusals, load_table

_NOTICE = "<!-- Made by python3 dev.py docs from {source}; edit that. -->"

_HEAD = """# Diagnostics

A diagnostic reports something that the program noticed while reading a capture, solving it or checking the result. The
console, the report, Blender's panel and `--json` all show the same diagnostics.

- An **error** means that the input or the result is rejected and no file is written. A solve rejects useless results
  with one of these codes: {refusals}. If the fault is small, the same code is only a warning. To keep a rejected
  result, use the option `--accept CODE`, the entry `"accept": ["CODE"]` in the `settings` of a
  [job file](job-file.md), or *Accepted Faults* in the panel.
- A **warning** means that the result may be wrong. With `--strict`, or `"strict": true` in a job file, a solve with
  warnings writes no file and ends with exit code 3.
- A **note** is only information. A solve that ends with "OK" may still have notes.

With `--json`, each diagnostic is an object with the keys `code`, `severity`, `where`, `values` and `remedy`. The object
`where` can have `file`, `frames` (pairs of first and last frame), `cameras`, `markers`, `joints` and `person`. The
`remedy` is {remedies}. A motion file stores its diagnostics in `provenance`.

Each code in the table links to its message, its usual cause and the remedy. `manifold explain CODE` prints the same
text, including all variants of a note.
[Error codes](errors.md) lists the errors that end a command."""

_ERRORS = """# Error codes

An error ends a command. The message states what happened, where it happened and what to do. With `--json`, the error
also has one of these codes, which `manifold explain CODE` explains. The exit code is 3 unless the table states another.
See also the [exit codes](command-line.md#exit-codes-and-json) and the [diagnostics](diagnostics.md), which do not end
a command.

| code | exit code | meaning |
|---|---|---|"""

USUAL_EXIT = 3  # Exit code of most errors. The page states only others.
GROUPS = {entry.group.lower().replace(" ", "-"): entry.group for entry in load_table().values()}
"""Groups of diagnostics by the end of their page's name."""


def diagnostics_page() -> str:
    """Return the overview page with the codes of each diagnostics group."""
    *others, last = (f"`{remedy.value}`" for remedy in Remedy)
    remedies = f"{', '.join(others)} or {last}"
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
    """Return the page of a diagnostics group, with a heading per code and every form of a warning."""
    parts = [_NOTICE.format(source="solver_backend/exchange/diagnostics.json"), "", f"# {GROUPS[page]}"]
    for code, entry in _entries(GROUPS[page]):
        first, *others = _forms(entry)
        others = [] if entry.severity is Severity.NOTE else others
        rows = [f"{entry.severity.value.title()}: {first}", *others]
        rows += [" ".join(filter(None, (entry.cause, entry.remedy)))]
        lines = [f"| {_slanted(text)} |" for text in rows if text]
        parts += ["", f"## {code}", "", lines[0], "|---|", *lines[1:]]
    return "\n".join([*parts, ""])


def errors_page() -> str:
    """Return the reference page of errors that end a command."""
    exits = {code: int(kind.exit_code) for code, kind in list_errors().items()}
    rows = [
        f"| `{code}` | {'' if exits[code] == USUAL_EXIT else exits[code]} | {kind.__doc__} |"
        for code, kind in list_errors().items()
    ]
    return "\n".join([_NOTICE.format(source="the docstrings of the errors"), "", _ERRORS, *rows, ""])


def _forms(entry: DiagnosticEntry) -> list[str]:
    """Return a diagnostic's message, and its variants for parameter values of several words."""
    values = {name: [*words.values()] for name, words in entry.words.items()}
    usual = {name: words[0] for name, words in values.items() if len(words) > 1}
    forms = [_filled(entry.text, usual)]
    for name, words in values.items():
        start = "or: " if entry.text.startswith("{" + name) else "… "
        forms += [f"{start}{word.lstrip(' ,.')}" for word in words[len(words) > 1 :] if word.count(" ") > 1]
    return forms


def _filled(text: str, chosen: dict[str, str]) -> str:
    return re.sub(r"\{(\w+)[^}]*\}", lambda found: chosen.get(found[1], found[0]), text)


def _entries(group: str) -> list[tuple[str, DiagnosticEntry]]:
    return sorted((code, entry) for code, entry in load_table().items() if entry.group == group)


def _slanted(text: str) -> str:
    option = r"`[^`]*`|(?<![\w-])--[a-z-]+(?: (?:on|off|z|[A-Z=]{4,}))*"
    marked = re.sub(option, lambda found: f"`{found[0].strip('`')}`", text)
    return re.sub(
        r"(?<=\w)\{when\}|\{(\w+)[^}]*\}", lambda found: f"*{found[1]}*" if found[1] else " *when*", marked
    ).replace("|", "\\|")
