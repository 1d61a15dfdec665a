"""The verbs of the solver in ``verbs.json``. Both programs, panels and reference pages use this table."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

from .marker_formats import FORMAT_NAMES, MARKER_FORMATS, file_names
from .reading_settings import ROWS as READING_ROWS
from .reading_settings import WorldSettings
from .setting import POSITIVE, REQUIRED, Choice, Setting, settings_of_class
from .solve_settings import SolveSettings
from .verb import Verb, flag, option, output, place, values
from .video_settings import DETECTORS
from .video_settings import ROWS as VIDEO_ROWS

SOLVE_ROWS = settings_of_class(SolveSettings)
READING = (SOLVE_ROWS["sync"], *READING_ROWS.values())
"""Reading options of a capture."""
SOLVING = tuple(row for name, row in SOLVE_ROWS.items() if name != "sync")
"""How a capture is solved. ``sync`` is among the options of reading."""
_TEXTS = {"formats": FORMAT_NAMES, "detectors": ", ".join(DETECTORS)}
"""Texts of other tables that descriptions hold in braces."""

Named = Mapping[str, Sequence[Setting]]  # Settings by the names that a table refers to them by.
Tables = Mapping[str, Iterable[str]]  # Values of choices by the name that a table refers to them by.


def read_rows(items: Sequence[Any], named: Named, tables: Tables) -> Iterator[Setting]:
    """Yield the settings of a list in a table. Unknown names and fields are a ``KeyError`` or a ``TypeError``.

    Args:
        items: each is a name of ``named``, or the fields of a ``Setting``. The key of the name is ``place`` for an
            argument, ``flag`` for a flag and ``name`` for an option. ``out`` is the metavar of the option ``--out``.
            ``like`` copies a named setting, with the other fields replaced.
    """
    for item in items:
        if isinstance(item, str):
            yield from named[item]
            continue
        given = {key: _value(key, value, tables) for key, value in item.items()}
        if "like" in given:
            [row] = named[given.pop("like")]
            yield replace(row, **given)
        elif "flag" in given:
            yield flag(given.pop("flag"), **given)
        elif "out" in given:
            yield output(given.pop("out"), **given)
        elif "place" in given:
            yield place(name=given.pop("place"), metavar=given.pop("metavar", ""), **given)
        else:
            default = REQUIRED if given.pop("required", False) else given.pop("default", None)
            yield option(default=default, metavar=given.pop("metavar", ""), **given)


def _value(key: str, value: Any, tables: Tables) -> Any:
    if key == "choices":
        items = tables[value] if isinstance(value, str) else value
        return tuple(Choice(*item) if isinstance(item, list) else values(item)[0] for item in items)
    if key == "endings":
        endings = ([f".{end}" for end in MARKER_FORMATS] if item == "markers" else [item] for item in value)
        return tuple(chain.from_iterable(endings))
    if key == "out":
        return "|".join(file_names(name[:-2]) if name.endswith(".*") else name for name in value.split("|"))
    if key == "description":
        return value.format(**_TEXTS)
    if value == "POSITIVE":
        return POSITIVE
    return tuple(value) if isinstance(value, list) else value


def read_verbs(
    path: Path, named: Named, tables: Tables | None = None
) -> tuple[dict[str, tuple[Setting, ...]], dict[str, str], dict[str, Verb]]:
    """Return the named settings, the groups and the verbs of a table.

    Args:
        path: JSON file with ``shared``, lists of settings by name, ``groups``, what the verbs of each do, and
            ``verbs``, fields of ``Verb`` by group and name. The group "" has the verbs without a group.
    """
    table = json.loads(path.read_text(encoding="utf-8"))
    shared, verbs = {name: tuple(rows) for name, rows in named.items()}, dict[str, Verb]()
    for name, items in table["shared"].items():
        shared[name] = tuple(read_rows(items if isinstance(items, list) else [items], shared, tables or {}))
    for group, rows in table["verbs"].items():
        for own, row in rows.items():
            name = f"{group} {own}".strip()
            row["example"] = f"{name} {row['example']}".strip()
            settings = tuple(read_rows(row.pop("settings", ()), shared, tables or {}))
            verbs[name] = Verb(name, help=row.pop("help").format(**_TEXTS), settings=settings, **row)
    return shared, table["groups"], verbs


_NAMED: Named = {
    "READING": READING,
    "SOLVING": SOLVING,
    "WORLD": tuple(settings_of_class(WorldSettings).values()),
    "SOLVING_OF_VIDEOS": tuple(row for row in SOLVING if row.name != "layout"),
    **{f"SolveSettings.{name}": (row,) for name, row in SOLVE_ROWS.items()},
    **{f"VideoSettings.{name}": (row,) for name, row in VIDEO_ROWS.items()},
}
SHARED, GROUPS, VERBS = read_verbs(Path(__file__).with_suffix(".json"), _NAMED)
"""Settings of several verbs, groups, and verbs by name, in the order of the help."""
