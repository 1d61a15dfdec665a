"""Reading named fields of our own npz files, with errors that name the file and the field."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from solver_backend.exchange.errors import FileDamaged
from solver_backend.io.files import read_npz
from solver_backend.types import JointSet


@dataclass(frozen=True)
class Fields:
    """The arrays of one npz file."""

    path: Path
    """Where they were read."""
    arrays: dict[str, np.ndarray]
    """Every array by name."""

    def __contains__(self, key: str) -> bool:
        return key in self.arrays

    def array(self, key: str) -> np.ndarray:
        """Return a required array.

        Raises:
            FileDamaged: the file lacks it.
        """
        if key not in self.arrays:
            raise FileDamaged(
                f"The file lacks '{key}'; it holds {', '.join(sorted(self.arrays)) or 'nothing'}.", where=str(self.path)
            )
        return self.arrays[key]

    def numbers(self, key: str, shape: tuple[int | None, ...]) -> np.ndarray:
        """Return a required numeric array as float64 whose shape matches (None = any length).

        Raises:
            FileDamaged: it is missing, not numeric or of another shape.
        """
        value = self.array(key)
        fits = value.ndim == len(shape) and all(
            want in (None, have) for want, have in zip(shape, value.shape, strict=True)
        )
        if value.dtype.kind not in "fiub" or not fits:
            wanted = "(" + ", ".join("any" if n is None else str(n) for n in shape) + ")"
            raise FileDamaged(
                f"'{key}' is {value.dtype} of shape {value.shape}; numbers of shape {wanted} are expected.",
                where=str(self.path),
            )
        return value.astype(np.float64)

    def number(self, key: str) -> float:
        """Return a required scalar."""
        return float(self.numbers(key, ()))

    def text(self, key: str, default: str | None = None) -> str:
        """Return a string, or the default where the field is absent and a default is given."""
        if key not in self.arrays and default is not None:
            return default
        value = self.array(key)
        if value.ndim:
            raise FileDamaged(f"'{key}' has shape {value.shape}; one string is expected.", where=str(self.path))
        item = value.item()
        return item.decode("utf-8", "replace") if isinstance(item, bytes) else str(item)

    def texts(self, key: str) -> tuple[str, ...]:
        """Return a list of strings; an absent field is an empty list."""
        return tuple(str(item) for item in np.atleast_1d(self.arrays.get(key, np.zeros(0, "U1"))))

    def joint_set(self, key: str = "joint_set") -> JointSet:
        """Return the joint set that is named.

        Raises:
            FileDamaged: the name is unknown.
        """
        name = self.text(key)
        try:
            return JointSet(name)
        except ValueError as error:
            known = ", ".join(s.value for s in JointSet)
            raise FileDamaged(f"Unknown joint set '{name}'; known are {known}.", where=str(self.path)) from error

    def require_format(self, name: str, version: int) -> None:
        """Check the file's format and version.

        Raises:
            FileDamaged: it is another format or a version from the future.
        """
        found = self.text("format", "")
        if found != name:
            what = f"its format is '{found}'" if found else "it names no format"
            raise FileDamaged(f"The file is not a {name}: {what}.", where=str(self.path))
        if self.number("version") > version:
            raise FileDamaged(
                f"The file is of version {self.number('version'):g}; this program reads up to {version}.",
                where=str(self.path),
                hint="Update the program.",
            )


def read_fields(path: Path | str) -> Fields:
    """Read the arrays of an npz file.

    Raises:
        FileMissing, FileDamaged: see ``read_npz``.
    """
    return Fields(Path(path), read_npz(path))
