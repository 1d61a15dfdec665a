"""What is killed: a command, the files it begins from, and what it leaves when it ends well."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Operation:
    """One command that writes files."""

    name: str
    prepare: Callable[[Path, Path], object]
    """Fills an empty folder from the folder of what was solved."""
    command: tuple[str, ...]
    """After the interpreter; run in the prepared folder."""
    outputs: frozenset[str]
    """Files it adds or replaces, relative to the folder."""
    kept: str = "(?!)"
    """Pattern of the names under which the next run keeps what a killed one has recorded."""
    begins_apart: bool = False
    """Outputs begin one by one, as sensors do: what had not begun is not in the recording that the next run keeps."""
