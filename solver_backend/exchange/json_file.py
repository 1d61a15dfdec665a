"""Read JSON files that people edit, with limits on size and depth."""

from __future__ import annotations

import json
import math
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

from .errors import FileDamaged
from .outputs import open_regular, require_file, unreadable

LARGEST = 20_000_000  # Size limit in bytes of a text file that a person or program writes. Real files have kilobytes.


def read_json_file(path: Path | str, largest: int = LARGEST) -> Any:
    """Return the value stored in a UTF-8 JSON file."""
    path = require_file(path)
    try:
        with open_regular(path) as stream:
            data = stream.read(largest + 1)
        text = data.decode("utf-8-sig") if len(data) <= largest else ""
    except OSError as error:
        raise unreadable(path, error) from error
    except UnicodeDecodeError as error:
        raise FileDamaged(f"The file cannot be read as text: {error}.", where=str(path)) from error
    if len(data) > largest:
        hint = "Check that it is the right file."
        raise FileDamaged(f"The file is larger than {largest / 1e6:g} MB.", where=str(path), hint=hint)
    return parse_json(text, path)


def parse_json(text: str, path: Path | str) -> Any:
    """Parse the JSON text of a file. ``path`` is used in errors."""
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        message = f"The file is truncated or is not JSON ({error})."
        raise FileDamaged(message, where=str(path), hint="Copy or export it again.") from error


def as_plain(value: Any) -> Any:
    """Convert a value to JSON types. Non-finite numbers become null."""
    if is_dataclass(value):
        value = {item.name: getattr(value, item.name) for item in fields(value)}
    if isinstance(value, dict):
        return {str(key): as_plain(item) for key, item in value.items()}
    if hasattr(value, "tolist"):  # a NumPy or PyTorch value, detected without importing either
        return as_plain(value.tolist())
    if isinstance(value, list | tuple):
        return [as_plain(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if value is None or isinstance(value, bool | int | str) else str(value)
