"""Load the solver's verbs from ``verbs.json``."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache
from itertools import chain
from pathlib import Path
from typing import Any

from .marker_formats import FORMAT_NAMES, MARKER_FORMATS, file_names
from .setting import POSITIVE, REQUIRED, Choice, Setting, settings_of_class
from .verb import Verb, flag, option, output, place, values

Named = Mapping[str, Sequence[Setting]]  # Settings by the names that a table uses for them.
Tables = Mapping[str, Iterable[str]]  # Values of choices by the names that a table uses for them.


def read_rows(items: Sequence[Any], named: Named, tables: Tables) -> Iterator[Setting]:
    """Yield the settings that a list in a table describes. Raise ``KeyError`` for unknown names.

    Args:
        items: each is a name in ``named``, or a mapping with the fields of a ``Setting``. The setting's name is under
            the key ``place`` for a positional argument, ``flag`` for a flag and ``name`` for an option. The key ``out``
            declares the option ``--out``, and its value is the metavar. The key ``like`` copies a setting in ``named``,
            and the remaining keys replace fields of the copy. An output file must have the suffix in its metavar,
            because readers recognise our files by their suffix.
    """
    for item in items:
        if isinstance(item, str):
            yield from named[item]
            continue
        item = _with_endings(item)
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


def _with_endings(item: Mapping[str, Any]) -> Mapping[str, Any]:
    name = item.get("out", "") or (item.get("metavar", "") if item.get("place") == "out" else "")
    stems, dots, endings = zip(*(part.rpartition(".") for part in name.split("|")), strict=True)
    if "endings" in item or not item.get("is_output", True) or not all(dots) or not any(stems):
        return item
    return {**item, "endings": ["markers" if ending == "*" else f".{ending}" for ending in endings]}


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
        return value.format(**_texts()) if "{" in value else value
    if value == "POSITIVE":
        return POSITIVE
    return tuple(value) if isinstance(value, list) else value


@cache
def _texts() -> dict[str, str]:
    """Return the texts that replace names in braces, such as ``{formats}``, in descriptions of settings."""
    from .video_settings import DETECTORS

    return {"formats": FORMAT_NAMES, "detectors": ", ".join(DETECTORS)}


def read_verbs(
    path: Path, named: Callable[[], Named], tables: Tables | None = None
) -> tuple[Callable[[], Named], dict[str, str], dict[str, Verb]]:
    """Read a table of verbs.

    Settings are created when a verb needs them, so that the program does not create all of them at start-up.

    Args:
        path: JSON file with ``shared`` (lists of settings by name), ``groups`` (what each group does) and ``verbs``
            (fields of ``Verb`` by group and name). The group "" contains the verbs without a group.
        named: returns settings by the names that the table uses.
        tables: values of choices by the names that the table uses.

    Returns:
        A function that returns the shared settings by name, the groups, and the verbs by name.
    """
    table, verbs = json.loads(path.read_text(encoding="utf-8")), dict[str, Verb]()

    @cache
    def shared() -> Named:
        found = dict(named())
        for name, items in table["shared"].items():
            found[name] = tuple(read_rows(items if isinstance(items, list) else [items], found, tables or {}))
        return found

    def declared(items: Sequence[Any]) -> Callable[[], tuple[Setting, ...]]:
        return lambda: tuple(read_rows(items, shared(), tables or {}))

    for group, rows in table["verbs"].items():
        for own, row in rows.items():
            name = f"{group} {own}".strip()
            row["example"] = f"{name} {row['example']}".strip()
            settings = declared(row.pop("settings", ()))
            verbs[name] = Verb(name, declared=settings, **row)
    return shared, table["groups"], verbs


def _of_classes() -> Named:
    """Return the settings declared by dataclasses, by their names in ``verbs.json``."""
    from .reading_settings import ROWS, WorldSettings  # not needed for help
    from .solve_settings import SolveSettings
    from .video_settings import ROWS as VIDEO_ROWS

    solving = dict(settings_of_class(SolveSettings))
    named: dict[str, Sequence[Setting]] = {f"SolveSettings.{name}": (row,) for name, row in solving.items()}
    named |= {f"VideoSettings.{name}": (row,) for name, row in VIDEO_ROWS.items()}
    named["READING"] = (solving.pop("sync"), *ROWS.values())
    named["SOLVING"] = tuple(solving.values())
    named["WORLD"] = tuple(settings_of_class(WorldSettings).values())
    named["SOLVING_OF_VIDEOS"] = tuple(row for row in solving.values() if row.name != "layout")
    return named


shared, GROUPS, VERBS = read_verbs(Path(__file__).with_suffix(".json"), _of_classes)
"""Function that returns shared settings by name, the groups, and the verbs by name in help order."""
