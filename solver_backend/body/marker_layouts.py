"""Read the data file of marker layouts: marker locations, their names, and names of computed points."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any

from solver_backend.body.label_words import LabelWords, Letters, words_of_file
from solver_backend.exchange.errors import FileDamaged
from solver_backend.exchange.json_file import read_json_file

DEFAULT = Path(__file__).parents[1] / "assets" / "marker_layouts.json"
FORMAT, VERSION = "manifold_mocap_marker_layouts", 1
_SIDE_LAST = re.compile(r"(.+?)(?:[ ._-]([LR])|[ ._-]?(LEFT|RIGHT))")
_SIDE_FIRST = re.compile(r"(LEFT|RIGHT)(.+)")
# pyCGM2 and Visual3D append the model's name and version to a point: LHJC_CGM_2.4, _PELVIS_CGM_2.4O.
_MODEL = re.compile(r"[ _.]?(PY)?CGM[ _.]?\d*([._]\d+)*")
_PELVIS = "@pelvis"  # The bone without a side. Labels for it in a family have no side either.
_LEAST_SIGNS = 2  # Number of specific labels that identify a naming system. One of them may occur in any file.


@dataclass(frozen=True)
class Family:
    """Marker names from one naming system. They are used only if several labels of a recording fit the system."""

    signs: frozenset[str]  # Names, as keys. Two of them identify the system.
    names: dict[str, str]  # Location by name: a marker location, or ``@`` and a joint.
    virtual: frozenset[str]  # Names of computed points.

    def fits(self, keys: frozenset[str]) -> bool:
        """Return whether a recording with these label keys uses this naming system."""
        return len(self.signs & keys) >= _LEAST_SIGNS


@dataclass(frozen=True)
class LayoutFile:
    """Contents of a marker layouts file (see ``docs/how-to/extend.md``)."""

    kinds: dict[str, tuple[float, float]]  # Spread in metres for each kind of location, off the skin and along it.
    midline: dict[str, dict[str, Any]]  # Rule for each midline location.
    sided: dict[str, dict[str, Any]]  # Rule for each location on the left side, by its name without L.
    aliases: dict[str, str]  # Location for each alternative name, in the form of ``label_key``.
    names: dict[str, str]  # Location for every name, including its own.
    virtual: re.Pattern[str]  # Names of points that a program computed: joint centres and segment axes.
    layouts: dict[str, tuple[str, ...]]  # Marker names of each layout.
    label_sets: dict[str, tuple[str, ...]]  # Labels in other systems' layouts, as their files write them.
    words: LabelWords  # Words in several languages, with their locations.
    families: dict[str, Family]  # Names in each system, by system.

    @cached_property
    def places_read(self) -> dict[tuple[str, Letters], tuple[str, ...]]:
        """Cache of the locations that each name means. The key is a name and the letters that mean a side."""
        return {}

    def place_of(self, label: str) -> str | None:
        """Return the location that a label names, or None if the layouts do not list the label.

        The subject name, case and punctuation are ignored. The side may come first or last: ``Anna:l_asis``, ``ASIS.L``
        and ``Left ASIS`` are the same location.
        """
        return next((self.names[key] for key in keys_of(label) if key in self.names), None)

    def spread_of(self, name: str) -> tuple[float, float]:
        """Return the standard deviations of a location in metres: perpendicular to the skin, and along the skin."""
        place = self.names[name]
        return self.kinds[(self.midline.get(place) or self.sided[place[1:]])["kind"]]

    def is_virtual(self, label: str) -> bool:
        """Return whether a label names a point that a program computed, such as a joint centre."""
        return self.place_of(label) is None and self.virtual.fullmatch(_key(_MODEL.sub("", _bare(label)))) is not None


def label_key(label: str) -> str:
    """Reduce a label to its letters and digits, in capitals and without the subject's prefix."""
    return _key(_bare(label))


@cache
def load_layouts(path: Path = DEFAULT) -> LayoutFile:
    """Read a marker layouts file, by default the built-in one.

    Raises:
        FileMissing: the file does not exist.
        FileDamaged: the file is not JSON, has another format or an ambiguous name, or a location has no valid rule.
    """
    values = read_json_file(path)
    if not isinstance(values, dict) or (values.get("format"), values.get("version")) != (FORMAT, VERSION):
        raise FileDamaged(f"The file is not a {FORMAT} of version {VERSION}.", where=str(path))
    try:
        return _layouts(values, path)
    except (KeyError, TypeError, ValueError, AttributeError, IndexError, OverflowError, re.error) as error:
        raise FileDamaged(f"The layouts cannot be read: {error!r}.", where=str(path)) from error


def _layouts(values: dict[str, Any], path: Path) -> LayoutFile:
    places = {*values["midline"], *(side + part for part in values["sided"] for side in "LR")}
    names = {place: place for place in places}
    for place, alias in _aliases(values):
        if place not in places:
            raise FileDamaged(f"The name {alias} is for the position {place}, which has no rule.", where=str(path))
        if names.setdefault(alias, place) != place:
            raise FileDamaged(f"The name {alias} means both {names[alias]} and {place}.", where=str(path))
    for place, rule in [*values["midline"].items(), *values["sided"].items()]:
        if rule["kind"] not in values["kinds"]:
            known = ", ".join(values["kinds"])
            raise FileDamaged(
                f"The position {place} has the unknown kind {rule['kind']!r}. Known kinds: {known}.", where=str(path)
            )
    return LayoutFile(
        {kind: (1e-3 * spread["off_mm"], 1e-3 * spread["along_mm"]) for kind, spread in values["kinds"].items()},
        values["midline"],
        values["sided"],
        {alias: place for alias, place in names.items() if alias not in places},
        names,
        re.compile("|".join(values["virtual"])),
        *({name: tuple(labels) for name, labels in values[key].items()} for key in ("layouts", "label_sets")),
        words=words_of_file(values, frozenset(values["midline"])),
        families={name: _family(family, places, path) for name, family in values["families"].items()},
    )


def _family(values: dict[str, Any], places: set[str], path: Path) -> Family:
    names: dict[str, str] = {}
    for part, aliases in values["names"].items():
        for side, bone in (("L", "left"), ("R", "right")):
            place = f"@{bone}_{part[1:]}" if part[0] == "@" else side + part
            if part[0] != "@" and place not in places:
                raise FileDamaged(f"The position {place} in a group of names has no rule.", where=str(path))
            sided = {label_key(side + alias): place for alias in aliases}
            names |= dict.fromkeys(map(label_key, aliases), part) if part == _PELVIS else sided
    return Family(_both_sides(values["signs"]), names, _both_sides(values["virtual"]))


def _both_sides(names: list[str]) -> frozenset[str]:
    return frozenset(label_key(name.format(side=side)) for name in names for side in "LR")


def _aliases(values: dict[str, Any]) -> Iterator[tuple[str, str]]:
    for place, names in values["aliases"].items():
        for name in names:
            if place in values["midline"]:
                yield place, label_key(name)
                continue
            for side in "LR":
                yield side + place, label_key(name.format(side=side) if "{side}" in name else side + name)


def _bare(label: str) -> str:
    return label.rpartition(":")[2].strip().upper()


def _key(bare: str) -> str:
    return re.sub(r"[^A-Z0-9]", "", bare)


def keys_of(label: str) -> Iterator[str]:
    """Yield the forms of a label that the layouts may list: as written, then with its side as first letter."""
    yield label_key(label)
    if found := _SIDE_LAST.fullmatch(_bare(label)):
        yield (found[2] or found[3])[0] + re.sub(r"[^A-Z0-9]", "", found[1])
    if found := _SIDE_FIRST.match(label_key(label)):
        yield found[1][0] + found[2]
