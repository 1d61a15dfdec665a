"""Read the arrays in an npz file by name, type and shape."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from .errors import FileDamaged, MocapError
from .marker_formats import other_kind
from .npz import read_npz

if TYPE_CHECKING:
    from .joint_sets import JointSet

Shape = tuple[int | str | None, ...]  # Lengths of an array's axes. A name or None allows any length.


@dataclass(frozen=True)
class Fields:
    """The arrays in an npz file."""

    path: Path
    arrays: dict[str, np.ndarray]

    def __contains__(self, key: str) -> bool:
        return key in self.arrays

    def array(self, key: str) -> np.ndarray:
        """Return a required array, or raise ``FileDamaged`` if it is missing."""
        if key not in self.arrays:
            raise FileDamaged(
                f"The file does not contain '{key}'. It contains {', '.join(sorted(self.arrays)) or 'nothing'}.",
                where=str(self.path),
            )
        return self.arrays[key]

    def numbers(self, key: str, shape: Shape) -> np.ndarray:
        """Return a required numeric array as float64, or raise ``FileDamaged``."""
        value = self.array(key)
        if value.dtype.kind not in "fiub" or not fits(value.shape, shape):
            wanted = "(" + ", ".join(str(n) if isinstance(n, int) else "any" for n in shape) + ")"
            what = f"'{key}' is {value.dtype} of shape {value.shape}, but numbers of shape {wanted} are expected."
            raise FileDamaged(what, where=str(self.path))
        return value.astype(np.float64)

    def floats(self, key: str, invalid: type[MocapError]) -> np.ndarray:
        """Return a required array as float64. Raise the given error if it is not numeric."""
        value = self.array(key)
        if value.dtype.kind not in "fiub":
            raise invalid(f"{key} is {value.dtype}, but numbers are expected.", where=str(self.path))
        with np.errstate(invalid="ignore"):  # signalling NaN
            return np.asarray(value, np.float64)

    def first_number(self, key: str, invalid: type[MocapError]) -> float:
        """Return the first number in an array or scalar. Raise the given error if there is no number."""
        values = self.floats(key, invalid).ravel()
        if not values.size:
            raise invalid(f"{key} is empty, but a number is expected.", where=str(self.path))
        return float(values[0])

    def shaped(self, key: str, shape: Shape, invalid: type[MocapError]) -> np.ndarray:
        """Return an array as float64. Raise the given error if its shape does not match."""
        value = self.floats(key, invalid)
        if not fits(value.shape, shape):
            wanted = f"({', '.join(map(str, shape))}{',' if len(shape) == 1 else ''})"
            raise invalid(f"{key} has shape {value.shape}, but {wanted} is expected.", where=str(self.path))
        return value

    def number(self, key: str) -> float:
        """Return a required scalar as a float."""
        return float(self.numbers(key, ()))

    def text(self, key: str, default: str | None = None) -> str:
        """Return a string, or the default if the field is missing. Bytes are decoded as UTF-8."""
        if key not in self.arrays and default is not None:
            return default
        value = self.array(key)
        if value.size != 1:
            raise FileDamaged(f"'{key}' has shape {value.shape}, but one string is expected.", where=str(self.path))
        item = value.item()
        return item.decode("utf-8", "replace") if isinstance(item, bytes) else str(item)

    def texts(self, key: str) -> tuple[str, ...]:
        """Return a list of strings. A missing field gives an empty list."""
        return tuple(str(item) for item in np.ravel(self.arrays.get(key, ())))

    def joint_set(self) -> JointSet:
        """Return the joint set that the file states, or raise ``FileDamaged`` if it is unknown."""
        from .joint_sets import JointSet  # avoids a circular import through the body layout

        name = self.text("joint_set")
        try:
            return JointSet(name)
        except ValueError as error:
            known = ", ".join(s.value for s in JointSet)
            raise FileDamaged(f"Unknown joint set '{name}'. Known sets: {known}.", where=str(self.path)) from error

    def require_format(self, name: str, version: int) -> None:
        """Raise ``FileDamaged`` unless the file states this format and a version that is not later."""
        found = self.text("format", "")
        if found != name:
            raise other_kind(found, name, str(self.path))
        self._require_version(self.number("version"), version, "program")

    def accept_format(self, name: str, version: int) -> None:
        """Raise ``FileDamaged`` if the file states another format or a later version. Accept files that state none."""
        found = self.text("format", name)
        if found != name:
            raise other_kind(found, name, str(self.path))
        if "version" in self:
            self._require_version(self.first_number("version", FileDamaged), version, "add-on")

    def _require_version(self, found: float, version: int, reader: str) -> None:
        if not found <= version:
            what = f"The file has version {found:g}, but this {reader} reads up to {version}."
            raise FileDamaged(what, where=str(self.path), hint=f"Update the {reader}.")


def read_fields(path: Path | str, names: Iterable[str], *, prefix: str | None = None) -> Fields:
    """Read the named arrays in an npz file, and all arrays whose names start with a prefix."""
    known = frozenset(names)
    return Fields(
        Path(path), read_npz(path, lambda name: name in known or (prefix is not None and name.startswith(prefix)))
    )


def fits(found: tuple[int, ...], shape: Shape) -> bool:
    """Return whether an array has the expected shape."""
    return len(found) == len(shape) and all(
        have == want or not isinstance(want, int) for want, have in zip(shape, found, strict=True)
    )
