"""Text files as UTF-8, JSON and TOML, with errors that name the file."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

from solver_backend.exchange.errors import FileDamaged
from solver_backend.exchange.npz import require_file


def read_bytes(path: Path | str) -> bytes:
    """Read a whole file.

    Raises:
        FileMissing: there is no such file.
        FileDamaged: the file cannot be read.
    """
    path = require_file(path)
    try:
        return path.read_bytes()
    except OSError as error:
        raise FileDamaged(f"The file cannot be read: {error.strerror or error}.", where=str(path)) from error


def read_text(path: Path | str) -> str:
    """Read a text file as UTF-8 (with or without mark), or as Latin-1 where it is not UTF-8.

    Raises:
        FileMissing: there is no such file.
        FileDamaged: the file cannot be read.
    """
    data = read_bytes(path)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def read_json(path: Path | str) -> Any:
    """Read a JSON file.

    Raises:
        FileMissing, FileDamaged: there is no such file, or it is truncated or not JSON.
    """
    text = read_text(path)
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise FileDamaged(
            f"The file is truncated or is not JSON ({error}).", where=str(path), hint="Copy or export it again."
        ) from error


def read_toml(path: Path | str) -> dict[str, Any]:
    """Read a TOML file.

    Raises:
        FileMissing, FileDamaged: there is no such file, or it is truncated or not TOML.
    """
    text = read_text(path)
    try:
        return tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise FileDamaged(
            f"The file is truncated or is not TOML ({error}).", where=str(path), hint="Check the line that is named."
        ) from error
