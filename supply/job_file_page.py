"""Generate docs/reference/job-file.md from the classes that declare the keys of a job file."""

from __future__ import annotations

import ast
from pathlib import Path

_EXCHANGE = Path(__file__).resolve().parents[1] / "solver_backend" / "exchange"
_SOURCE = _EXCHANGE / "job_file.py"
_HEAD = """<!-- Made by python3 dev.py docs from solver_backend/exchange/job_file.py; edit that. -->

# The job file

A job file is a JSON file that defines the input, settings and output of one solve. Run it with `solve --job JOB.json`,
without other solve options. The *Solve* panel writes a job file next to each take.
[Batches](../how-to/batch-and-cluster.md#batches) accept a job without `capture` and `out`.

```json
{
  "version": 1,
  "capture": "trial",
  "out": "trial_take.npz",
  "report": "trial_take.html",
  "fps": 60,
  "settings": {"refine_window": 8, "smoothing": 2.0}
}
```

If a key is missing, its default applies. A job with an unknown key or another version is rejected. The
object `settings` contains [solve settings](settings.md). Paths are absolute, or relative to the job file's
folder."""
_TABLES = (
    (
        "JobFile",
        "",
        "The [reading settings](settings.md#reading), such as `offset`, `frames` and `scale`, are also keys of a job.",
    ),
    (
        "JobRange",
        "Solve a range again: `resolve`",
        "The object `resolve` describes the range. Frames outside it do not change.",
    ),
    ("JobContact", "Edited contacts: items of `contacts`", "The solver applies them to frames in the range."),
    ("JobPin", "Pinned poses: items of `pins`", "Each item is a pose that the solver keeps unchanged in its frame."),
)
_REQUIRED = "–"


def job_file_page() -> str:
    """Return the reference page of the job file."""
    source = _SOURCE.read_text(encoding="utf-8")
    classes = {node.name: node for node in ast.parse(source).body if isinstance(node, ast.ClassDef)}
    parts = [_HEAD]
    for name, title, text in _TABLES:
        parts += ["", *([f"## {title}", ""] if title else []), text, ""]
        parts += ["| key | type | default | meaning |", "|---|---|---|---|"]
        if name == "JobFile":
            parts.append("| `version` | number | – | 1 |")
        parts += [_row(*found) for found in _fields(classes[name], source.splitlines())]
    return "\n".join([*parts, ""])


def _fields(declared: ast.ClassDef, lines: list[str]) -> list[tuple[str, str, str, str]]:
    """Return name, type, default and description (the comment) of each field of a data class."""
    found = []
    for node in declared.body:
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            default = _REQUIRED if node.value is None else ast.unparse(node.value)
            text = lines[(node.end_lineno or node.lineno) - 1].partition("  # ")[2]
            if not text.strip():
                raise ValueError(f"{declared.name}.{node.target.id} has no comment on its last line.")
            found.append((node.target.id, ast.unparse(node.annotation), default, text))
    return found


def _row(name: str, kind: str, default: str, text: str) -> str:
    words = {"None": "null", "False": "false", "True": "true", "field(default_factory=dict)": "{}", "()": "[]"}
    shown = words.get(default, default)
    kinds = {"Path": "path", "bool": "boolean", "str": "text", "float": "number", "int": "number", "Any": "object"}
    parts = [part.strip() for part in kind.split("|") if part.strip() != "None"]
    described = " or ".join(kinds.get(part, "list") for part in parts)
    sentence = " ".join(text.split())
    for word, shown_as in {"``": "`", "None": "null", "|": "\\|"}.items():
        sentence = sentence.replace(word, shown_as)
    return f"| `{name}` | {described} | {shown if shown == _REQUIRED else f'`{shown}`'} | {sentence} |"
