"""Generate docs/reference/command-line*.md with all verbs and options of both programs."""

from __future__ import annotations

from collections import Counter

from blender_addon.headless.verb_table import program as blender_program
from solver_backend.cli.program import PROGRAM
from solver_backend.exchange.setting import Setting
from solver_backend.exchange.verb import Program, Verb, describe_default, describe_range, in_sentence
from solver_backend.exchange.verbs import GROUPS
from solver_backend.exchange.verbs import shared as named_settings

_SETTINGS = (
    ("SOLVING", 0.5, "the [solve settings](settings.md)"),
    ("READING", 1.0, "the [reading options](settings.md#reading)"),
    ("WORLD", 1.0, "the [world options](settings.md#world)"),
)  # Name of a group of settings, smallest fraction of its rows in a verb that links to it, and the link.
_MADE = """<!-- Made by python3 dev.py docs from the tables of verbs in solver_backend/exchange/verbs.json and
blender_addon/headless/verbs.json; edit those. -->

"""
_JSON = """A progress line contains `stage`, `done`, `total` and `eta_s`. The result of `solve` contains `motion`,
`report`, `frames`, `fps`, `duration_s`, `solve_s`, `reprojection_median_px`, `marker_median_mm`, `unseen_frames`,
`unsure_frames` and [`diagnostics`](diagnostics.md). Ignore keys that you do not know."""
_HEAD = """# Command line

`manifold VERB` runs the solver and needs only NumPy. Under `manifold blender`, the verbs that bake, render, export,
retarget or import also need Blender's Python module `bpy`.

| where you are | how to call it |
|---|---|
| a clone after `python3 dev.py setup` | `.venv/bin/manifold` (Windows: `.venv\\Scripts\\manifold`) |
| a clone without an environment | `python -m solver_backend` and `python -m blender_addon` |
| Blender with the extension | `blender --command manifold_mocap`, for the verbs of `manifold blender` |

`VERB --help` prints the options of a verb. `--help-all` adds the rarely used ones. Every verb also accepts `--json` and
`--verbose`."""


def command_line_page() -> str:
    """Return the page with verb groups, verbs outside groups, common options and exit codes."""
    rows = [f"| [`manifold {group}`](command-line-{group}.md) | {text} |" for group, text in GROUPS.items()]
    parts = [_MADE + _HEAD, "", "| group | purpose |", "|---|---|", *rows, "", *_verbs(PROGRAM, "")]
    parts += ["## Common options", "", *_table(_shared(PROGRAM)), ""]
    return "\n".join([*parts, "## Exit codes and JSON", "", "```text", PROGRAM.epilog, "```", "", _JSON, ""])


def group_page(group: str) -> str:
    """Return the reference page of a verb group."""
    program = blender_program(f"{PROGRAM.name} blender") if group == "blender" else PROGRAM
    text = GROUPS[group]
    parts = [f"{_MADE}# {group.title()} verbs", "", f"{text[:1].upper()}{text[1:]}.", ""]
    return "\n".join([*parts, *_verbs(program, group)])


def _verbs(program: Program, group: str) -> list[str]:
    """Return a section per verb of a group, and a section for the arguments that several verbs have."""
    verbs = [verb for verb in program.shown if group in ("blender", verb.group)]
    everywhere = _shared(PROGRAM) if program is PROGRAM else []
    shown = (row for verb in verbs for row in _shown(verb) if row not in everywhere and not _settings(verb, row))
    here = _most_frequent(Counter(shown), 2)
    parts = [line for verb in verbs for line in _describe(verb, program, everywhere, here)]
    return [*parts, *(["## Common arguments", "", *_table(here), ""] if here else [])]


def _shown(verb: Verb) -> list[Setting]:
    return [row for row in verb.settings if not row.hidden]


def _shared(program: Program) -> list[Setting]:
    """Return the options of all verbs or of several groups, except settings, which have their own page."""
    rows = Counter({row: len(GROUPS) for row in program.common() if not row.hidden})
    for group in ("", *GROUPS):
        verbs = [verb for verb in program.shown if verb.group == group]
        named = (row for verb in verbs for row in _shown(verb) if not (row.positional or _settings(verb, row)))
        rows.update(dict.fromkeys(named).keys())
    return _most_frequent(rows, 2)


def _most_frequent(counts: Counter[Setting], least: int) -> list[Setting]:
    """Return the arguments that occur at least ``least`` times. Of two with the same name, return the more frequent."""
    most = {_name(row): row for row, _ in reversed(counts.most_common())}
    rows = (row for row in most.values() if counts[row] >= least and (row.positional or row.name != "out"))
    return sorted(rows, key=lambda row: (not row.positional, _name(row)))


def _name(row: Setting) -> str:
    return (row.options or (row.metavar,))[-1]


def _settings(verb: Verb, row: Setting) -> str:
    """Return the link to an argument's settings group if the verb has enough of that group, or else ""."""
    for name, least, link in _SETTINGS:
        group = named_settings()[name]
        if row in group and sum(own in group for own in verb.settings) >= least * len(group):
            return link
    return ""


def _describe(verb: Verb, program: Program, everywhere: list[Setting], here: list[Setting]) -> list[str]:
    links = {row: _settings(verb, row) for row in _shown(verb)}
    listed = [row for row, link in links.items() if not link and row not in everywhere and row not in here]
    lines = [f"## {verb.name}", "", f"{verb.help[:1].upper()}{verb.help[1:]}.", ""]
    lines += ["```sh", f"{program.name} {verb.example}", "```", ""]
    lines += [*_table(listed), ""] if listed else []
    page = "" if not verb.group else "command-line.md"
    others = [
        f"[{', '.join(names)}]({target})"
        for target, rows in (("#common-arguments", here), (f"{page}#common-options", everywhere))
        if (names := [f"`{_name(row)}`" for row in links if row in rows])
    ]
    others += dict.fromkeys(filter(None, links.values()))
    if verb.passes_on:
        page = f"command-line{'-' * bool(verb.group)}{verb.group}.md#{verb.name.replace(' ', '-')}"
        others += [f"the options of [`{PROGRAM.name} {verb.name}`]({page})"]
    return [*lines, *([f"Also: {', '.join(others)}.", ""] if others else [])]


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
    """Describe an argument with its choices, range and default in sentences."""
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
    """Return whether the table's argument cell lists the choices. Otherwise, the argument's description lists them."""
    return bool(row.choices) and (not row.metavar or not row.of_class) and row.metavar != "CODE"
