"""Read and check values in JSON descriptions. Errors state the location and the valid values."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping
from dataclasses import fields
from typing import Any, TypeVar, cast

import numpy as np

from solver_backend.exchange.errors import JobInvalid, MocapError


class StudioInvalid(JobInvalid):
    """The description of a data set contains an unknown key or preset, a wrong type or an invalid value."""

    code = "studio_invalid"


class NobodySeen(MocapError):
    """In a simulated shot, no camera ever sees the person."""


class CameraInsideBody(MocapError):
    """In a simulated shot, a camera is inside the person or touches the person."""


class DiskTooSmall(MocapError):
    """The data set needs more space than is free on the disk."""


class OtherDataSet(MocapError):
    """The output folder contains a different data set, or other files."""


T = TypeVar("T")
_LARGEST = sys.float_info.max  # JSON allows larger integers. Infinite and missing values are also outside this range.


class CheckedValues:
    """An object in a JSON description. ``where`` is its name in error messages.

    Raises:
        StudioInvalid: the description is not an object, or contains an unknown key.
    """

    def __init__(self, values: Any, where: str, known: Iterable[str]) -> None:
        keys = sorted(known)
        if not isinstance(values, Mapping):
            raise StudioInvalid(f"{where} is {_kind(values)}, but an object with keys is expected.", where=where)
        unknown = sorted(map(str, set(values) - set(keys)))
        if unknown:
            raise StudioInvalid(
                f"Unknown key {', '.join(unknown)}.", where=where, hint=f"Known keys: {', '.join(keys)}."
            )
        self._values, self.where = values, where

    @classmethod
    def described(
        cls, description: Any, where: str, known: Iterable[str], presets: Mapping[str, Mapping[str, Any]]
    ) -> CheckedValues:
        """Read the values of a named preset, or of an object that may extend a preset.

        The preset's name is the default value of the key ``name``, if that key is known.

        Raises:
            StudioInvalid: a key or preset is unknown.
        """
        given = {"preset": description} if isinstance(description, str) else description
        values, keys = cls(given, where, ("preset", *known)), tuple(known)
        if "preset" not in values:
            return values
        name = values.raw("preset")
        if not isinstance(name, str) or name not in presets:
            hint = f"Known names: {', '.join(sorted(presets))}."
            raise StudioInvalid(f"There is no {where} '{name}'.", where=f"{where}: preset", hint=hint)
        named = {"name": name} if "name" in keys else {}
        rest = {key: value for key, value in given.items() if key != "preset"}
        return cls({**named, **presets[name], **rest}, f"{where} {name}", keys)

    def __contains__(self, key: str) -> bool:
        return key in self._values

    def raw(self, key: str, default: Any = None) -> Any:
        """Return a value without checking it."""
        return self._values.get(key, default)

    def number(self, key: str, default: float, low: float, high: float) -> float:
        """Return a number, or raise ``StudioInvalid`` unless it is from ``low`` to ``high``."""
        value = self._values.get(key, default)
        if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
            raise self._bad(key, value, f"a number from {low:g} to {high:g}")
        return float(value)

    def whole(self, key: str, default: int, low: int, high: int) -> int:
        """Return an integer, or raise ``StudioInvalid`` unless it is from ``low`` to ``high``."""
        value = self._values.get(key, default)
        if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
            raise self._bad(key, value, f"a whole number from {low} to {high}")
        return value

    def flag(self, key: str, default: bool) -> bool:
        """Return a boolean, or raise ``StudioInvalid`` for any other value."""
        value = self._values.get(key, default)
        if not isinstance(value, bool):
            raise self._bad(key, value, "true or false")
        return value

    def text(self, key: str, default: str) -> str:
        """Return a string. An empty one is valid only if the default is empty."""
        value = self._values.get(key, default)
        if not isinstance(value, str) or (not value and default):
            raise self._bad(key, value, "a text")
        return value

    def choice(self, key: str, default: str, known: Iterable[str]) -> str:
        """Return a name, or raise ``StudioInvalid`` unless it is in ``known``."""
        value, names = self._values.get(key, default), tuple(known)
        if value not in names:
            raise self._bad(key, value, f"one of {', '.join(names)}")
        return value

    def choices(self, key: str, default: Iterable[str], known: Iterable[str]) -> tuple[str, ...]:
        """Return a list of names in ``known`` without duplicates."""
        value, names = self._values.get(key, list(default)), tuple(known)
        if not isinstance(value, list) or any(item not in names for item in value):
            raise self._bad(key, value, f"a list of {', '.join(names)}")
        return tuple(dict.fromkeys(value))

    def numbers(self, key: str, count: int) -> np.ndarray:
        """Return a list of ``count`` finite numbers."""
        value = self._values.get(key)
        good = isinstance(value, list) and len(value) == count
        good = good and all(isinstance(v, int | float) and not isinstance(v, bool) for v in value or ())
        if not good or not all(-_LARGEST <= v <= _LARGEST for v in value or ()):
            raise self._bad(key, value, f"{count} numbers")
        return np.array(value, dtype=np.float64)

    def size(self, key: str, default: tuple[int, int]) -> tuple[int, int]:
        """Return width and height in pixels, 16 to 8192 each."""
        value = self._values.get(key, list(default))
        good = isinstance(value, list) and len(value) == 2
        if not good or not all(isinstance(v, int) and not isinstance(v, bool) and 16 <= v <= 8192 for v in value):
            raise self._bad(key, value, "a width and a height from 16 to 8192 pixels, such as [640, 480]")
        return int(value[0]), int(value[1])

    def fill(self, kind: type[T], limits: Mapping[str, Any], **given: Any) -> T:
        """Build a dataclass from the description's values. Missing values are the defaults of the dataclass.

        Args:
            limits: the range of each number and the names of each choice. Fields without an entry are booleans.
            given: values of the fields without a default.
        """
        for key, ends in limits.items():
            default = getattr(kind, key)
            if isinstance(default, str):
                given[key] = self.choice(key, default, ends)
            else:
                given[key] = (self.whole if isinstance(default, int) else self.number)(key, default, *ends)
        flags = [f.name for f in fields(cast(Any, kind)) if isinstance(f.default, bool)]
        return kind(**given, **{key: self.flag(key, getattr(kind, key)) for key in flags})

    def _bad(self, key: str, value: Any, expected: str) -> StudioInvalid:
        return StudioInvalid(f"{key} = {value!r} is not valid. It must be {expected}.", where=f"{self.where}: {key}")


def _kind(value: Any) -> str:
    return "missing" if value is None else f"a {type(value).__name__}"
