"""What a setting is: one row with type, range, default, unit, words and group."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from math import isfinite
from numbers import Real
from typing import Any, Literal

from .errors import JobInvalid

Kind = Literal["switch", "whole", "number", "choice", "text", "file", "name_or_file", "texts", "numbers", "range"]
"""A "file" is a path as text; "texts" and "numbers" are lists; a "range" is the first and the last whole number."""


@dataclass(frozen=True)
class Choice:
    """One of the values that a setting of the kind "choice" may have."""

    value: str
    """As in a job file and on the command line."""
    label: str
    """In a panel."""
    description: str
    """A sentence without a full stop."""


@dataclass(frozen=True)
class Setting:
    """One setting."""

    kind: Kind
    """What its values are."""
    label: str
    """Noun phrase of the panel."""
    description: str
    """A sentence without a full stop: the tooltip and the help text."""
    group: str
    """What it is listed under."""
    low: float | None = None
    """Least value of numbers."""
    high: float | None = None
    """Greatest value of numbers."""
    soft_high: float | None = None
    """Where the panel's slider ends, if before ``high``."""
    unit: str = ""
    """Of numbers; "" for a plain factor."""
    count: int = 0
    """How many there are, of the kind "numbers"."""
    choices: tuple[Choice, ...] = ()
    """Of the kind "choice"."""
    metavar: str = ""
    """What stands for the value in help texts."""
    in_panel: bool = True
    """False where the panel has something of its own for it, such as sliders."""
    methods: tuple[str, ...] = ()
    """Methods of a solve in which it acts; of all where there is none."""

    @property
    def expected(self) -> str:
        """What would be valid, for messages."""
        between = f"from {self.low:g} to {self.high:g}" if self.kind in ("whole", "number") else ""
        return {
            "switch": "true or false", "whole": f"a whole number {between}", "number": f"a number {between}",
            "choice": f"one of {', '.join(choice.value for choice in self.choices)}", "text": "text",
            "file": "the path of a file",
            "name_or_file": "a name or the path of a file", "texts": f"a list of {self.metavar}",
            "numbers": f"{self.count} numbers or null", "range": "the first and the last whole number, from 0",
        }[self.kind]  # fmt: skip

    def acts_in(self, method: str) -> bool:
        """Return whether it does anything in a method of a solve."""
        return not self.methods or method in self.methods

    def accepts(self, value: Any) -> bool:
        """Return whether a value is valid; true and false are no numbers."""
        if self.kind == "switch":
            return isinstance(value, bool)
        if self.kind in ("whole", "number"):
            kind = int if self.kind == "whole" else Real
            return _is_number(value, kind) and (self.low or 0) <= value <= (self.high or 0)
        if self.kind == "choice":
            return value in [choice.value for choice in self.choices]
        if self.kind == "numbers":
            return is_list(value) and len(value) == self.count and all(map(_is_finite, value))
        if self.kind == "range":
            return is_list(value) and len(value) == 2 and _is_range(*value)
        if self.kind == "texts":
            return is_list(value) and all(isinstance(item, str) for item in value)
        return isinstance(value, str) and (self.kind in ("file", "text") or bool(value.strip()))


def setting(kind: Kind, default: Any, label: str, description: str, *, group: str, **more: Any) -> Any:
    """Return the field of a dataclass that declares a setting.

    Args:
        kind: see ``Setting``.
        default: its value where none is given.
        label: see ``Setting``.
        description: see ``Setting``.
        group: see ``Setting``.
        more: the other fields of ``Setting``.
    """
    return field(default=default, metadata={"setting": Setting(kind, label, description, group, **more)})


def settings_of_class(cls: Any) -> dict[str, Setting]:
    """Return the settings that a dataclass declares, by name, in its order."""
    return {item.name: item.metadata["setting"] for item in fields(cls) if "setting" in item.metadata}


def defaults_of_class(cls: Any) -> dict[str, Any]:
    """Return the default of each setting that a dataclass declares."""
    return {item.name: item.default for item in fields(cls) if "setting" in item.metadata}


def check_settings(values: Any) -> None:
    """Check each value of a dataclass of settings; None is valid where it is the default.

    Raises:
        JobInvalid: one is of another type or out of range; the message names it and what is expected.
    """
    defaults = defaults_of_class(values)
    for name, row in settings_of_class(values).items():
        value = getattr(values, name)
        if not (value is None and defaults[name] is None) and not row.accepts(value):
            raise JobInvalid(f"The setting {name} = {value!r} is not valid; {row.expected} is expected.", where=name)


def known_values(cls: Any, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return plain values as a dataclass of settings takes them: lists as tuples, without those that are None.

    Raises:
        JobInvalid: a name is unknown.
    """
    known = settings_of_class(cls)
    unknown = sorted(set(values) - set(known))
    if unknown:
        raise JobInvalid(f"Unknown setting {', '.join(unknown)}.", hint=f"Known settings: {', '.join(known)}.")
    given = {name: value for name, value in values.items() if value is not None}
    return {name: tuple(value) if is_list(value) else value for name, value in given.items()}


def is_list(value: Any) -> bool:
    """Return whether a value is a list of others; text is none."""
    return isinstance(value, Sequence) and not isinstance(value, str)


def _is_range(first: Any, last: Any) -> bool:
    return _is_number(first, int) and _is_number(last, int) and 0 <= first <= last


def _is_finite(value: Any) -> bool:
    return _is_number(value, Real) and isfinite(value)


def _is_number(value: Any, kind: type) -> bool:
    return isinstance(value, kind) and not isinstance(value, bool)
