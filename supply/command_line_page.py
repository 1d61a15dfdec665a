"""The page docs/reference/command-line.md: every verb and option, made from the two programs' tables of verbs."""

from __future__ import annotations

from collections import Counter
from itertools import groupby

from blender_addon.headless.verb_table import program as blender_program
from solver_backend.cli.arguments import PROGRAM
from solver_backend.exchange.setting import Setting
from solver_backend.exchange.verb import Program, Verb, help_of
from solver_backend.exchange.verbs import SOLVING

SHARED = 4  # An option that so many verbs take is listed once.
_HEAD = """<!-- Made by python3 dev.py docs from the tables of verbs in solver_backend/exchange/verbs.json and
blender_addon/headless/verbs.json; edit those. -->

# Command line

Two programs: the solver, which needs NumPy alone, and the Blender side, which runs in any Python with the module `bpy`
and as `blender --command manifold_mocap VERB`. `VERB --help` prints the same text."""


def command_line_page() -> str:
    """Return the page that lists every verb and option of both programs."""
    parts = [_HEAD, ""]
    for program, title, many in (
        (PROGRAM, "The solver", "Options of many verbs"),
        (blender_program(), "The Blender side", "Options of many verbs of the Blender side"),
    ):
        shared = _shared(program)
        parts += [f"## {title}: `{program.name} VERB`", ""]
        for task, verbs in groupby(program.verbs.values(), key=lambda verb: verb.task):
            parts += [f"### {task}", ""]
            for verb in verbs:
                parts += _describe(verb, program, shared)
        parts += [f"### {many}", "", *_table(shared), ""]
    return "\n".join([*parts, "## Exit codes and JSON", "", "```text", PROGRAM.epilog, "```", ""])


def _shown(verb: Verb, program: Program) -> list[Setting]:
    return [row for row in (*verb.settings, *program.common) if not row.hidden]


def _shared(program: Program) -> list[Setting]:
    """Return the options that several verbs take in the same way."""
    counts = Counter(row for verb in program.verbs.values() for row in _shown(verb, program) if not row.required)
    return [row for row, count in counts.items() if count >= SHARED and not row.positional]


def _describe(verb: Verb, program: Program, shared: list[Setting]) -> list[str]:
    rows = _shown(verb, program)
    settings = [row for row in rows if row in SOLVING]
    if 2 * len(settings) < len(SOLVING):
        settings = []
    listed = [row for row in rows if row not in shared and row not in settings]
    others = [f"`{row.options[-1]}`" for row in rows if row in shared and row not in settings]
    lines = [f"#### {verb.name}", "", f"{verb.help[:1].upper()}{verb.help[1:]}.", ""]
    lines += ["```sh", f"{program.name} {verb.example}", "```", ""]
    lines += [*_table(listed), ""] if listed else []
    if settings:
        lines += ["It also takes the [settings of a solve](settings.md) as options.", ""]
    lines += [f"Options of many verbs: {', '.join(others)}.", ""] if others else []
    return (
        [*lines, f"Takes every option of the solver's [`{verb.name}`](#{verb.name}).", ""] if verb.passes_on else lines
    )


def _table(rows: list[Setting]) -> list[str]:
    return ["| argument | what it does |", "|---|---|", *map(_row, rows)]


def _row(row: Setting) -> str:
    names = " ".join(f"`{name}`" for name in row.options)
    if row.kind == "switch":
        names += f" `--no-{row.options[-1][2:]}`"
    values = _values(row)
    text = f"{help_of(row)}{' (required)' if row.required and row.options else ''}"
    cells = (" ".join(filter(None, (names, f"`{values}`" if values else ""))), text)
    return f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"


def _values(row: Setting) -> str:
    if row.kind in ("switch", "flag"):
        return ""
    listed = "|".join(choice.value for choice in row.choices)
    metavar = row.metavar or {"whole": "N", "number": "X"}.get(row.kind, row.name.upper())
    text = listed if listed and (not row.metavar or not row.of_class) and row.metavar != "CODE" else metavar
    return f"{text} …" if row.many else text
