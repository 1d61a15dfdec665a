"""Text files as UTF-8, JSON and TOML of bounded size and depth, with errors that name the file."""

from __future__ import annotations

import codecs
import re
import tomllib
from pathlib import Path
from typing import Any

from solver_backend.exchange.errors import FileDamaged
from solver_backend.exchange.json_file import parse_json
from solver_backend.exchange.outputs import read_regular, require_file

LARGEST_TAKE, LARGEST_TEXT = 1_000_000_000, 20_000_000
"""Bytes of a take; and of a calibration, a job or a frame's detections, of which real ones have thousands."""
_LARGEST_TOML = 2_000_000
LONGEST_HEADING = 200
"""Characters of a column's heading at most: patterns take time that grows with the square of what they look into."""
_MOST_KEY_PARTS = 32
"""Dotted parts of a key of TOML at most; chosen by hand."""
_KEY_PART = re.compile(r"""\.[ \t]*(?:[\w-]+|"(?:[^"\\\n]|\\.)*"|'[^'\n]*')[ \t]*(?=\.)""")


def read_bytes(path: Path | str, largest: int = LARGEST_TAKE) -> bytes:
    """Read a file that is not larger than files of its kind are.

    Raises:
        FileMissing: there is no such file.
        FileDamaged: it is larger, or cannot be read.
    """
    try:
        data, size = read_regular(path, largest)
    except OSError as error:
        require_file(path)
        raise FileDamaged(f"The file cannot be read: {error.strerror or error}.", where=str(path)) from error
    if max(size, len(data)) > largest:
        raise FileDamaged(
            f"The file has {max(size, len(data)) / 1e6:,.1f} MB; a file of this kind has at most {largest / 1e6:g} MB.",
            where=str(path),
            hint="Check that it is the right file, or remove it.",
        )
    return data


def read_text(path: Path | str, largest: int = LARGEST_TAKE) -> str:
    """Read a text file, see ``as_text``.

    Raises:
        FileMissing, FileDamaged: see ``read_bytes``.
    """
    return as_text(read_bytes(path, largest))


def as_text(data: bytes) -> str:
    """Return bytes as UTF-16 with its mark (Excel's Unicode text), as UTF-8 with or without one, else as Latin-1."""
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return data.decode("utf-16", "replace")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def read_json(path: Path | str) -> Any:
    """Read a JSON file.

    Raises:
        FileMissing, FileDamaged: there is no such file, or it is truncated or not JSON.
    """
    return parse_json(read_text(path, LARGEST_TEXT), path)


def read_toml(path: Path | str) -> dict[str, Any]:
    """Read a TOML file.

    Raises:
        FileMissing, FileDamaged: there is no such file, or it is truncated or not TOML.
    """
    text = read_text(path, _LARGEST_TOML)
    try:
        # Python's parser takes quadratic time for keys of many parts.
        if any(len(_KEY_PART.findall(line)) > _MOST_KEY_PARTS for line in text.splitlines()):
            raise tomllib.TOMLDecodeError(f"a key has more than {_MOST_KEY_PARTS} parts")
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        hint = "Check the line that is named."
        raise FileDamaged(f"The file is truncated or is not TOML ({error}).", where=str(path), hint=hint) from error
