"""What was made of what: a step whose inputs are as before is not done again."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from solver_backend.exchange.errors import FileDamaged
from solver_backend.exchange.outputs import write_text
from solver_backend.io.files import read_json

NAME = "steps.json"
_BEGUN = ""
"""Key of an output that is being made: made of nothing."""


class Records:
    """The record of one take's steps, kept beside its results."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / NAME
        self._keys: dict[str, str] = {}
        if self._path.is_file():
            with suppress(FileDamaged):
                kept = read_json(self._path)
                self._keys = {str(k): str(v) for k, v in kept.items()} if isinstance(kept, dict) else {}

    def is_made(self, output: Path, made_of: Any) -> bool:
        """Return whether an output is there and was made of this (plain values)."""
        return output.is_file() and self._keys.get(output.name) == key_of(made_of)

    def is_ours(self, output: Path) -> bool:
        """Return whether we made an output, of whatever it was, so that it may be replaced."""
        return output.name in self._keys

    @contextmanager
    def making(self, output: Path) -> Iterator[None]:
        """Remember that an output is ours before it is written: however this process ends, the next replaces it."""
        self._keys[output.name] = _BEGUN
        self._write()
        try:
            yield
        except BaseException:
            if not output.exists():
                del self._keys[output.name]
                self._write()
            raise

    def made(self, output: Path, made_of: Any) -> None:
        """Remember what an output was made of."""
        self._keys[output.name] = key_of(made_of)
        self._write()

    def _write(self) -> None:
        write_text(self._path, json.dumps(self._keys, indent=2, sort_keys=True) + "\n", overwrite=True)


def key_of(values: Any) -> str:
    """Return a short hash of plain values."""
    return hashlib.blake2b(json.dumps(values, sort_keys=True, default=str).encode(), digest_size=12).hexdigest()
