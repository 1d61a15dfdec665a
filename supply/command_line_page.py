"""Generate docs/reference/command-line*.md: all verbs and options from the two programs' verb tables."""

from __future__ import annotations

from collections import Counter

from blender_addon.headless.verb_table import program as blender_program
from solver_backend.cli.program import PROGRAM
from solver_backend.exchange.setting import Setting
from solver_backend.exchange.verb import Program, Verb, describe_default, describe_range, in_sentence
from solver_backend.exchange.verbs import GROUPS
from solver_backend.exchange.verbs import shared as named_settings

SHARED = 3  # An option of at least this many verbs is listed once.
_MADE = """<!-- Made by python3 dev.py docs from the tables of verbs in solver_backend/exchange/verbs.json and
blender_addon/headless/verbs.json; edit those. -->

"""
_JSON = """A progress line has `stage`, `done`, `total` and `eta_s`. The result of `solve` has `motion`, `report`,
`frames`, `fps`, `duration_s`, `solve_s`, `reprojection_median_px`, `marker_median_mm`, `unseen_frames`,
`unsure_frames` and `diagnostics`. Each diagnostic has `code`, `severity`, `where`, `values` and `remedy`.
The lines have no version, so ignore keys that you do not know."""
_HEAD = """# Command line

`manifold VERB` runs the solver and needs only NumPy. Under `manifold blender`, the verbs that bake, render, export,
retarget or import also need Blender's Python module `bpy`.

| where you are | how to call it |
|---|---|
| a clone after `python3 dev.py setup` | `.venv/bin/manifold` (Windows: `.venv\\Scripts\\manifold`) |
| a clone without an environment | `python -m solver_backend` and `python -m blender_addon` |
| Blender with the extension | `blender --command manifold_mocap`, for the verbs of `manifold blender` |

`VERB --help` prints the options of a verb. `--help-all` adds the rarely used ones."""


def command_line_page() -> str:
    """Return the page with the groups, the verbs outside groups, common options and exit codes."""
    shared = _shared(PROGRAM)
    rows = [f"| [`manifold {group}`](command-line-{group}.md) | {text} |" for group, text in GROUPS.items()]
    parts = [_MADE + _HEAD, "", "| group | purpose |", "|---|---|", *rows, ""]
    for verb in PROGRAM.verbs.values():
        parts += [] if verb.group else _describe(verb, PROGRAM, shared)
    parts += ["## Common options", "", *_table(shared), ""]
    return "\n".join([*parts, "## Exit codes and JSON", "", "```text", PROGRAM.epilog, "```", "", _JSON, ""])


def group_page(group: str) -> str:
    """Return the page of a group's verbs."""
    program = blender_program(f"{PROGRAM.name} blender") if group == "blender" else PROGRAM
    text, shared = GROUPS[group], _shared(program)
    parts = [f"{_MADE}# {group.title()} verbs", "", f"{text[:1].upper()}{text[1:]}.", ""]
    for verb in program.shown:
        parts += _describe(verb, program, shared) if group in ("blender", verb.group) else []
    if group == "blender":
        parts += ["## Common options", "", *_table(shared), ""]
    return "\n".join(parts)


def _shown(verb: Verb, program: Program) -> list[Setting]:
    return [row for row in (*verb.settings, *program.common()) if not row.hidden]


def _shared(program: Program) -> list[Setting]:
    """Return the options that several verbs share."""
    counts = Counter(row for verb in program.shown for row in _shown(verb, program) if not row.required)
    most = {row.options[-1]: row for row, _ in reversed(counts.most_common()) if not row.positional}
    return [row for row, count in counts.items() if count >= SHARED and most.get(row.options[-1]) is row]


def _describe(verb: Verb, program: Program, shared: list[Setting]) -> list[str]:
    rows = _shown(verb, program)
    solving = named_settings()["SOLVING"]
    settings = [row for row in rows if row in solving]
    if 2 * len(settings) < len(solving):
        settings = []
    listed = [row for row in rows if row not in shared and row not in settings]
    others = [f"`{row.options[-1]}`" for row in rows if row in shared and row not in settings]
    lines = [f"## {verb.name}", "", f"{verb.help[:1].upper()}{verb.help[1:]}.", ""]
    lines += ["```sh", f"{program.name} {verb.example}", "```", ""]
    lines += [*_table(listed), ""] if listed else []
    if settings:
        lines += ["It also takes the [settings of a solve](settings.md) as options.", ""]
    page = "" if program is not PROGRAM else "command-line.md"
    many = f"[Common options]({page}#common-options)"
    lines += [f"{many}: {', '.join(others)}.", ""] if others else []
    if verb.passes_on:
        page = f"command-line{'-' * bool(verb.group)}{verb.group}.md#{verb.name.replace(' ', '-')}"
        lines += [f"Takes every option of the solver's [`{verb.name}`]({page}).", ""]
    return lines


def _table(rows: list[Setting]) -> list[str]:
    return ["| argument | meaning |", "|---|---|", *map(_row, rows)]


def _row(row: Setting) -> str:
    names = " ".join(f"`{name}`" for name in row.options)
    if row.kind == "switch":
        names += f" `--no-{row.options[-1][2:]}`"
    values = _values(row)
    text = _sentences(row)
    cells = (" ".join(filter(None, (names, f"`{values}`" if values else ""))), text)
    return f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"


def _sentences(row: Setting) -> str:
    """Return a description of an argument with its choices, range and default, as sentences."""
    parts = [f"{row.description}."]
    if row.kind == "choice" and _lists_choices(row):
        parts += [f"`{c.value}`: {in_sentence(c.description)}." for c in row.choices if c.description]
    elif bounds := describe_range(row):
        parts.append(f"{'One of' if row.kind == 'choice' else 'Range:'} {bounds}.")
    parts += ["Required."] * (row.required and bool(row.options))
    parts += [f"Default: {default}."] if (default := describe_default(row)) else []
    parts += ["Repeatable."] * (row.repeated or row.kind == "texts")
    return " ".join(parts)


def _values(row: Setting) -> str:
    if row.kind in ("switch", "flag"):
        return ""
    listed = "|".join(choice.value for choice in row.choices)
    metavar = row.metavar or {"whole": "N", "number": "X"}.get(row.kind, row.name.upper())
    text = listed if _lists_choices(row) else metavar
    return f"{text} …" if row.many else text


def _lists_choices(row: Setting) -> bool:
    """Return whether the values are listed next to the option. Otherwise the text lists them."""
    return bool(row.choices) and (not row.metavar or not row.of_class) and row.metavar != "CODE"
