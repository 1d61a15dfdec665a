"""The pages docs/reference/diagnostics*.md and errors.md, made from the table of diagnostics and the errors."""

from __future__ import annotations

import re

from solver_backend.cli.explain import list_errors
from solver_backend.exchange.diagnostics import DiagnosticEntry, Remedy, list_refusals, load_table

_NOTICE = "<!-- Made by python3 dev.py docs from {source}; edit that. -->"

_HEAD = """# Diagnostics

A diagnostic is something that a reader, a solve or the check of its result found. The console, the report, Blender's
panel and `--json` show the same list. The texts below are the ones they use, with names and figures of the take.

- **error**: the input or the result is refused, and no file is written. A solve refuses results that are surely
  useless: {refusals}. The same code is a warning if the fault is small. To accept a result anyway, use
  `--accept CODE` of `solve`, `from-videos` and `batch`, `"accept": ["CODE"]` in the `settings` of a job, or
  *Accepted Faults* in the panel.
- **warning**: the result may be wrong. `solve` ends with one line per warning and "Look at …". With `--strict`,
  `"strict": true` in a job file, or `batch --strict`, warnings refuse the result: exit code 3, no file is written.
- **note**: worth knowing. A solve that ends with "OK" may have notes.

With `--json` each diagnostic is an object with `code`, `severity`, `where`, `values` and `remedy`. `where` has `file`,
`frames` as pairs of first and last, `cameras`, `markers`, `joints` and `person`. Empty ones are omitted. `remedy`
states what the program did: {remedies}. A motion file has the list in `provenance` under `diagnostics`.

*Cause* is the usual one. `manifold explain CODE` prints the text of one code, and `manifold explain` lists all codes.
*Slanted* words are filled in from your recording. [Error codes](errors.md) lists the errors that end a command."""

_ERRORS = """# Error codes

An error ends a command. Its message states what happened, where, and what to try. With `--json` it also has a `code`.
`manifold explain CODE` prints one of these texts, and `manifold explain` lists all codes. What a solve finds without
ending is a [diagnostic](diagnostics.md). See also the [exit codes](command-line.md#exit-codes-and-json).

| code | exit code | meaning |
|---|---|---|"""

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
    parts = [_NOTICE.format(source="solver_backend/exchange/diagnostics.json"), "", f"# {GROUPS[page]}"]
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
    return re.sub(r"\{(\w+)[^}]*\}", r"*\1*", text).replace("|", "\\|")
