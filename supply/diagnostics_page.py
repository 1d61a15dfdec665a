"""The page docs/reference/diagnostics.md, made from the table of diagnostics."""

from __future__ import annotations

import re

from solver_backend.exchange.diagnostics import REFUSALS, DiagnosticEntry, Remedy
from solver_backend.exchange.diagnostics.table import GROUPS

_NOTICE = "<!-- Made by python3 dev.py docs from {source}; edit that. -->"

_HEAD = """# Diagnostics

What the reader of a capture, a solve and the check of its result can find. The console, the report, Blender's panel
and `--json` show the same list; the words below are the ones they use, with the names and figures of the take.

- **error**: the input or the result is refused, nothing is written. Some results are surely useless: {refusals}.
  To take one as a warning instead, use `--accept CODE` of `solve`, `from-videos` and `batch`, `"accept": ["CODE"]` in
  the `settings` of a job, or *Accepted Faults* in the panel.
- **warning**: the result may be wrong. `solve` ends with every warning on a line and "Look at …". With `--strict`,
  `"strict": true` in a job file, or with `batch --strict` it refuses the result: exit code 3, nothing is written.
- **note**: worth knowing. A solve whose last line is "OK" may have notes.

With `--json` each is an object with `code`, `severity`, `where`, `values` and `remedy`. `where` holds `file`, `frames`
as pairs of first and last, `cameras`, `markers`, `joints` and `person`; empty ones are left out. `remedy` is what the
program did about it: {remedies}. A motion file holds the list in `provenance` under `diagnostics`.
A program of another version shows a code that it does not know by its name."""


def diagnostics_page() -> str:
    """Return the page that lists every diagnostic."""
    remedies = ", ".join(f"`{remedy.value}`" for remedy in Remedy)
    head = _HEAD.replace("{remedies}", remedies).replace("{refusals}", ", ".join(f"`{code}`" for code in REFUSALS))
    parts = [_NOTICE.format(source="solver_backend/exchange/diagnostics"), "", head]
    for title, group in GROUPS.items():
        parts += [
            "",
            f"## {title}",
            "",
            "| code | severity | words | usual cause | what to do |",
            "|---|---|---|---|---|",
        ]
        parts += [_row(code, entry) for code, entry in sorted(group.items())]
    return "\n".join([*parts, ""])


def _row(code: str, entry: DiagnosticEntry) -> str:
    words = [re.sub(r"\{(\w+)[^}]*\}", r"*\1*", text).replace("|", "\\|") for text in (entry.what, entry.advice)]
    return f"| `{code}` | {entry.severity.value} | {words[0]} | {entry.cause} | {words[1] or '–'} |"
