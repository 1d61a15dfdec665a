"""The page docs/reference/command-line.md: every verb and option, made from the two programs' parsers."""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterator
from itertools import groupby

from blender_addon.headless.arguments import SOLVERS_VERBS
from blender_addon.headless.arguments import parser as blender_parser
from blender_addon.headless.verb_table import VERBS
from solver_backend.cli.arguments import EPILOG, build_parser
from solver_backend.cli.setting_options import ROWS, help_of
from solver_backend.cli.verb_table import TASKS

SHARED = 4
"""An option that so many verbs take the same way is listed once."""

_HEAD = """<!-- Made by python3 dev.py docs from the programs' own parsers; edit those. -->

# Command line

Two programs: the solver, which needs NumPy alone, and the Blender side, which runs in any Python with the module `bpy`
and as `blender --command manifold_mocap VERB`. `VERB --help` prints what stands here."""


def command_line_page() -> str:
    """Return the page that lists every verb and option of both programs."""
    solver = _verbs(build_parser())
    blender = _verbs(blender_parser("python -m blender_addon"))
    parts = [_HEAD, "", "## The solver: `python -m solver_backend VERB`"]
    for task, rows in TASKS.items():
        parts += ["", f"### {task}", ""]
        for verb in rows:
            parts += _describe(
                verb.name, solver[verb.name], _shared(solver), f"python -m solver_backend {verb.example}"
            )
    parts += ["### Options of many verbs", "", *_table(_shared_actions(solver))]
    parts += ["", "## The Blender side: `python -m blender_addon VERB`", ""]
    for task, rows in groupby(VERBS.items(), key=lambda item: item[1].task):
        parts += [f"### {task}", ""]
        for verb, row in rows:
            parts += _describe(verb, blender[verb], _shared(blender), f"python -m blender_addon {row.example}")
            if verb in SOLVERS_VERBS:
                parts += [f"Takes every option of the solver's [`{verb}`](#{verb}).", ""]
    parts += ["### Options of many verbs of the Blender side", "", *_table(_shared_actions(blender))]
    return "\n".join([*parts, "", "## Exit codes and JSON", "", "```text", EPILOG, "```", ""])


def _verbs(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    (action,) = (found for found in parser._actions if isinstance(found, argparse._SubParsersAction))
    help_of = {choice.dest: choice.help or "" for choice in action._choices_actions}
    for name, own in action.choices.items():
        own.description = own.description or f"{help_of[name][:1].upper()}{help_of[name][1:]}."
    return dict(action.choices)


def _shown(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    for action in parser._actions:
        if action.help != argparse.SUPPRESS and not isinstance(action, argparse._HelpAction):
            yield action


def _shared(verbs: dict[str, argparse.ArgumentParser]) -> set[int]:
    """Return the identities of the actions that several verbs take from one parent."""
    counts = Counter(id(action) for own in verbs.values() for action in _shown(own))
    return {key for key, count in counts.items() if count >= SHARED}


def _shared_actions(verbs: dict[str, argparse.ArgumentParser]) -> list[argparse.Action]:
    shared = _shared(verbs)
    found = {id(action): action for own in verbs.values() for action in _shown(own) if id(action) in shared}
    return list(found.values())


def _describe(verb: str, own: argparse.ArgumentParser, shared: set[int], example: str) -> list[str]:
    actions = list(_shown(own))
    long = [next(name for name in a.option_strings if name.startswith("--")) for a in actions if id(a) in shared]
    others = [f"`{name}`" for name in long]
    settings = [a for a in actions if _is_setting(a)]
    if 2 * len(settings) < len(ROWS):
        settings = []
    listed = [a for a in actions if id(a) not in shared and a not in settings]
    lines = [f"#### {verb}", "", own.description or "", ""]
    lines += ["```sh", example, "```", ""] if example else []
    lines += [*_table(listed), ""] if listed else []
    if settings:
        lines += ["It also takes the [settings of a solve](settings.md) as options.", ""]
    lines += [f"Options of many verbs: {', '.join(others)}.", ""] if others else []
    return lines


def _is_setting(action: argparse.Action) -> bool:
    """Whether an option is a setting of a solve, and not another one of the same name."""
    row = ROWS.get(action.dest)
    return row is not None and (action.help or "").startswith(help_of(row))


def _table(actions: list[argparse.Action]) -> list[str]:
    return ["| argument | what it does |", "|---|---|", *(_row(action) for action in actions)]


def _row(action: argparse.Action) -> str:
    names = " ".join(f"`{name}`" for name in action.option_strings)
    values = _values(action)
    text = (action.help or "").replace("%%", "%")
    if action.required and action.option_strings:
        text = f"{text} (required)".strip()
    cells = (" ".join(filter(None, (names, f"`{values}`" if values else ""))), text or "–")
    return f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"


def _values(action: argparse.Action) -> str:
    if action.nargs == 0:
        return ""
    name = action.metavar or ("|".join(map(str, action.choices)) if action.choices else action.dest.upper())
    text = " ".join(name) if isinstance(name, tuple) else name
    return f"{text} …" if action.nargs in ("+", "*") else text
