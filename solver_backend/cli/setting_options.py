"""The settings of a solve and of its world as options of a command line, made from the rows that declare them."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from itertools import groupby
from typing import Any

from solver_backend.exchange.reading_settings import DEFAULTS as READING_DEFAULTS
from solver_backend.exchange.reading_settings import ROWS as READING_ROWS
from solver_backend.exchange.reading_settings import WorldSettings
from solver_backend.exchange.setting import Setting, defaults_of_class, settings_of_class
from solver_backend.exchange.solve_settings import SolveSettings

ROWS = settings_of_class(SolveSettings)
WORLD_ROWS = settings_of_class(WorldSettings)
_ALL = ROWS | READING_ROWS
_DEFAULTS = defaults_of_class(SolveSettings) | READING_DEFAULTS


def add_settings(parser: argparse.ArgumentParser, names: Iterable[str] = ROWS) -> None:
    """Add settings to a parser, one group of options for each of theirs; what is not given is None.

    Args:
        parser: of a verb.
        names: of the settings; all of a solve if left out.
    """
    chosen = [(name, _ALL[name]) for name in _ALL if name in set(names)]
    for title, rows in groupby(chosen, key=lambda item: item[1].group):
        group = parser.add_argument_group(title)
        for name, row in rows:
            _add_option(group, name, row)


def given_settings(args: argparse.Namespace) -> dict[str, Any]:
    """Return the settings of a solve that stand on a command line, by name."""
    return _given(args, ROWS)


def given_reading(args: argparse.Namespace) -> dict[str, Any]:
    """Return the settings of how a capture is read that stand on a command line, by name."""
    return {name: tuple(v) if isinstance(v, list) else v for name, v in _given(args, READING_ROWS).items()}


def given_world(args: argparse.Namespace) -> dict[str, Any]:
    """Return the settings of the world that stand on a command line, by name."""
    return _given(args, WORLD_ROWS)


def _given(args: argparse.Namespace, rows: Iterable[str]) -> dict[str, Any]:
    values = {name: getattr(args, name, None) for name in rows}
    return {name: value for name, value in values.items() if value is not None}


def describe_range(row: Setting) -> str:
    """Return which values a setting may have, in a few words; "" for what its metavar states."""
    if row.kind == "choice":
        return ", ".join(choice.value for choice in row.choices)
    return f"{row.low:g} to {row.high:g}{f' {row.unit}' if row.unit else ''}" if row.low is not None else ""


def describe_default(name: str) -> str:
    """Return what a setting is where it is not given; "" for nothing."""
    value = _DEFAULTS[name]
    if isinstance(value, bool):
        return "on" if value else "off"
    return f"{value:g}" if isinstance(value, float) else str(value or "")


def option(name: str) -> str:
    """Return the option of a setting."""
    return f"--{name.replace('_', '-')}"


def help_of(row: Setting) -> str:
    """Return the words of a setting as help texts have them."""
    return f"{row.description[0].lower()}{row.description[1:]}".replace("%", "%%")


def _add_option(group: Any, name: str, row: Setting) -> None:
    bounds, default = describe_range(row), describe_default(name)
    repeated = ["may be repeated"] * (row.kind == "texts")
    more = "; ".join([bounds] * bool(bounds) + [f"default {default}"] * bool(default) + repeated)
    text = f"{help_of(row)}{f' ({more})' if more else ''}"
    group.add_argument(option(name), dest=name, default=None, help=text, **_how(row))


def _how(row: Setting) -> dict[str, Any]:
    """Return how argparse reads a setting; what is valid is checked by the settings themselves."""
    return {
        "switch": {"action": argparse.BooleanOptionalAction},
        "whole": {"type": int, "metavar": "N"},
        "number": {"type": float, "metavar": "X"},
        "choice": {"metavar": row.metavar},
        "text": {"metavar": row.metavar},
        "file": {"metavar": row.metavar},
        "name_or_file": {"metavar": row.metavar},
        "texts": {"metavar": row.metavar, "action": "append"},
        "numbers": {"metavar": row.metavar, "type": _numbers},
        "range": {"metavar": tuple(row.metavar.split()), "type": int, "nargs": 2},
    }[row.kind]


def _numbers(text: str) -> tuple[float, ...]:
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text} is not a list of numbers with commas between") from None
