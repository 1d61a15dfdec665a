"""The page docs/reference/diagnostics.md, made from the table of diagnostics."""

from __future__ import annotations

import re
from itertools import groupby

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
A program of another version shows an unknown code by its name.

*Slanted* words are parameters. If a parameter has named values, the text of each value follows in a list."""


def diagnostics_page() -> str:
    """Return the page that lists every diagnostic."""
    remedies = ", ".join(f"`{remedy.value}`" for remedy in Remedy)
    head = _HEAD.replace("{remedies}", remedies).replace("{refusals}", ", ".join(f"`{c}`" for c in list_refusals()))
    parts = [_NOTICE.format(source="solver_backend/exchange/diagnostics.json"), "", head]
    for title, rows in groupby(load_table().items(), key=lambda item: item[1].group):
        parts += [
            "",
            f"## {title}",
            "",
            "| code | severity | text | usual cause | what to do |",
            "|---|---|---|---|---|",
        ]
        parts += [_row(code, entry) for code, entry in sorted(rows)]
    return "\n".join([*parts, ""])


def _row(code: str, entry: DiagnosticEntry) -> str:
    text = _slanted(entry.text)
    for name, words in entry.words.items():
        text += f"<br>*{name}*:" + "".join(f"<br>`{value}` {_slanted(word)}".rstrip() for value, word in words.items())
    return f"| `{code}` | {entry.severity.value} | {text} | {entry.cause} | {_slanted(entry.remedy) or '–'} |"


def _slanted(text: str) -> str:
    return re.sub(r"\{(\w+)[^}]*\}", r"*\1*", text).replace("|", "\\|")
