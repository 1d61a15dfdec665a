"""Define settings as table rows, which determine the command line, panels, jobs and documentation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields, replace
from functools import cache
from math import inf
from numbers import Real
from pathlib import Path
from typing import Any, Literal

from .errors import JobInvalid

Kind = (
    Literal["switch", "flag", "whole", "number", "choice", "text"]
    | Literal["path", "folder", "file", "name_or_file", "texts", "numbers", "range"]
)
"""A "switch" can be turned off on the command line. A "flag" is off unless given. A "path" is a ``Path``, a "folder" is
the ``Path`` of a folder, and a "file" is a path as text. "texts" and "numbers" are lists. A "range" is the first and
last whole number."""
POSITIVE = 1e-12  # Lower bound for numbers that must be greater than 0.
REQUIRED = MISSING  # Default of a setting that must be given.
_FILE = "the path of a file"
_EXPECTED: dict[str, str] = {
    **dict.fromkeys(("switch", "flag"), "true or false"),
    **dict.fromkeys(("path", "file"), _FILE),
    "text": "text",
    "folder": "the path of a folder",
    "name_or_file": f"a name or {_FILE}",
    "range": "the first and the last whole number, from 0",
}
"""Description of the valid values of each kind."""


@dataclass(frozen=True)
class Choice:
    """One value of a setting of kind "choice"."""

    value: str  # Value in a job file and on the command line.
    label: str  # Label in the panel.
    description: str  # Sentence without full stop.


@dataclass(frozen=True)
class Setting:
    """A setting of a verb (subcommand), of a solve, or of a reader."""

    kind: Kind
    label: str  # Noun phrase in the panel.
    description: str  # Tooltip and help text: a sentence without full stop.
    group: str = ""  # Heading in help and panels. Empty if the options belong to one verb.
    low: float | None = None  # Smallest number, or smallest count for "numbers".
    high: float | None = None  # Largest number, or largest count for "numbers".
    soft_high: float | None = None  # End of the panel's slider if smaller than ``high``.
    unit: str = ""  # Unit of numbers, or "" for a plain factor.
    count: int = 0  # Number of values. 0 means one, or any number for "numbers".
    choices: tuple[Choice, ...] = ()
    metavar: str = ""  # Placeholder for the value in help texts.
    control: str = ""  # Special control in the panel, for the reference page. Empty for a property.
    methods: tuple[str, ...] = ()  # Solve methods that use the setting. Empty if all do.
    name: str = ""  # Key in job files, and name of the parsed argument and the panel property.
    default: Any = None
    of_class: bool = False
    """True if declared in a dataclass, which has the default. The command line then passes None if not given."""
    option: str = ""  # Command line options, separated by spaces. Empty means ``--name``.
    positional: bool = False  # True if identified by its position on the command line.
    required: bool = False
    many: bool = False  # Accepts one or more values.
    repeated: bool = False  # Can be given several times, which gives a list.
    excludes: str = ""  # Settings of a verb that have the same text here exclude each other.
    endings: tuple[str, ...] = ()  # Allowed file suffixes, including dots. Empty allows any.
    is_output: bool = False  # True for a file that the verb writes. It is checked before work begins.
    hidden: bool = False  # Omitted from help and reference pages.
    rare: bool = False  # Omitted from ``--help``, but listed by ``--help-all``.

    @property
    def in_panel(self) -> bool:
        """True if the panel has a property for the setting."""
        return not self.control

    @property
    def options(self) -> tuple[str, ...]:
        """Command line options, or none for a positional argument."""
        if self.positional:
            return ()
        return tuple(self.option.split()) or (f"--{self.name.replace('_', '-')}",)

    @property
    def expected(self) -> str:
        """Description of the valid values, for messages."""
        if self.kind in ("whole", "number"):
            return f"a {'whole ' if self.kind == 'whole' else ''}number{self._between}"
        if self.kind == "choice":
            return f"one of {', '.join(choice.value for choice in self.choices)}"
        if self.kind == "texts":
            return f"a list of {self.metavar}"
        if self.kind == "numbers":
            return f"a list of {self.count or f'{self.low} to {self.high}'} numbers"
        return _EXPECTED[self.kind]

    @property
    def _between(self) -> str:
        if self.low is None:
            return ""
        start = " above 0" if self.low == POSITIVE else f" from {self.low:g}"
        return f"{start}{'' if self.high is None else f' to {self.high:g}'}{self.unit and ' '}{self.unit}"

    def acts_in(self, method: str) -> bool:
        """Return whether a solve method uses the setting."""
        return not self.methods or method in self.methods

    def accepts(self, value: Any) -> bool:
        """Return whether a value is valid. True and False are not numbers."""
        if self.kind in ("switch", "flag"):
            return isinstance(value, bool)
        if self.kind in ("whole", "number"):
            kind = int if self.kind == "whole" else Real
            low, high = (-inf if self.low is None else self.low), (inf if self.high is None else self.high)
            return _is_number(value, kind) and abs(value) < inf and low <= value <= high
        if self.kind == "choice":
            return value in [choice.value for choice in self.choices]
        if self.kind == "numbers":
            least, most = (self.count, self.count) if self.count else (self.low or 0, self.high or inf)
            finite = is_list(value) and all(_is_number(item, Real) and abs(item) < inf for item in value)
            return finite and least <= len(value) <= most
        if self.kind == "range":
            whole = is_list(value) and len(value) == 2 and all(_is_number(item, int) for item in value)
            return whole and 0 <= value[0] <= value[1]
        if self.kind == "texts":
            return is_list(value) and all(isinstance(item, str) for item in value)
        if self.kind in ("path", "folder"):
            return isinstance(value, Path)
        return isinstance(value, str) and (self.kind in ("file", "text") or bool(value.strip()))

    def words(self, value: Any) -> list[str]:
        """Return the command line arguments that specify a value. An empty value needs none."""
        if value is None or (is_list(value) and not value):
            return []
        if self.positional:
            return [str(item) for item in value] if is_list(value) else [str(value)]
        option = self.options[-1]
        if self.kind == "switch":
            return [option if value else f"--no-{option[2:]}"]
        if self.kind == "flag":
            return [option] if value else []
        if self.repeated or self.kind == "texts":
            return [f"{option}={item}" for item in value]
        if self.kind == "numbers":
            return [f"{option}={','.join(text_of_value(float(number)) for number in value)}"]
        if is_list(value):
            return [option, *map(text_of_value, value)]
        return [f"{option}={text_of_value(value)}"]


def text_of_value(value: Any) -> str:
    """Convert a value to command line text that is parsed back to the same value."""
    if not isinstance(value, float):
        return str(value)
    short = f"{value:g}"
    return short if float(short) == value else repr(float(value))


def setting(kind: Kind, default: Any, label: str, description: str, *, group: str, **more: Any) -> Any:
    """Declare a setting as a dataclass field. If it has no default, pass ``REQUIRED``."""
    row = Setting(kind, label, description, group, default=default, required=default is REQUIRED, **more)
    return field(default=default, metadata={"setting": row})


def settings_of_class(cls: Any) -> dict[str, Setting]:
    """Return the settings declared by a dataclass or its instance, keyed by name, in order."""
    return _settings_of(cls if isinstance(cls, type) else type(cls))


@cache
def _settings_of(cls: Any) -> dict[str, Setting]:
    declared = {item.name: item.metadata["setting"] for item in fields(cls) if "setting" in item.metadata}
    return {name: replace(row, name=name, of_class=True) for name, row in declared.items()}


def defaults_of_class(cls: Any) -> dict[str, Any]:
    """Return the default of each setting declared by a dataclass."""
    return {name: row.default for name, row in settings_of_class(cls).items()}


def values_that_differ(values: Any, rows: Mapping[str, Setting]) -> dict[str, Any]:
    """Return the settings of an object that differ from their defaults, as plain JSON values by name."""
    given = {name: value for name, row in rows.items() if (value := getattr(values, name)) != row.default}
    given = {name: value for name, value in given.items() if value or rows[name].default}
    return {name: list(v) if is_list(v) else str(v) if isinstance(v, str) else v for name, v in given.items()}


def check_settings(values: Any) -> None:
    """Raise ``JobInvalid`` unless every value in a settings dataclass is valid."""
    for name, row in settings_of_class(values).items():
        value = getattr(values, name)
        if not (value is None and row.default is None) and not row.accepts(value):
            what = f"The setting {name} = {value!r} is not valid. It must be {row.expected}."
            raise JobInvalid(what, where=name, hint=_in_metres(row, value) or f"{name}: {row.description}.")


def _in_metres(row: Setting, value: Any) -> str:
    """Return a hint if a length that is invalid in metres would be valid in cm or mm, otherwise ""."""
    sizes = (value / 100, value / 1000) if row.unit == "m" and _is_number(value, Real) and value > 0 else ()
    valid = [size for size in sizes if row.accepts(size)]
    return f"Lengths are in metres: {valid[0]:g}." if valid else ""


def known_values(cls: Any, values: Mapping[str, Any]) -> dict[str, Any]:
    """Remove None from settings, and convert lists to tuples. Raise ``JobInvalid`` for unknown names."""
    known = settings_of_class(cls)
    unknown = sorted(set(values) - set(known))
    if unknown:
        raise JobInvalid(f"Unknown setting {', '.join(unknown)}.", hint=f"Known settings: {', '.join(known)}.")
    given = {name: value for name, value in values.items() if value is not None}
    return {name: tuple(value) if is_list(value) else value for name, value in given.items()}


def is_list(value: Any) -> bool:
    """Return whether a value is a list of values rather than text."""
    return isinstance(value, Sequence) and not isinstance(value, str)


def _is_number(value: Any, kind: type) -> bool:
    return isinstance(value, kind) and not isinstance(value, bool)
