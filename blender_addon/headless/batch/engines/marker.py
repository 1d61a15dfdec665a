"""A small file in the folder of the results by which workers know that they see it, and whose batch it is."""

from __future__ import annotations

import secrets
from contextlib import suppress
from pathlib import Path

from ...._exchange.outputs import write_text

NAME = ".batch"


def put_marker(out: Path) -> str:
    """Write a new marker and return what it states.

    Raises:
        OutputNotWritable: the folder cannot be written to.
    """
    text = secrets.token_hex(16)
    out.mkdir(parents=True, exist_ok=True)
    write_text(out / NAME, text, overwrite=True)
    return text


def marker_in(out: Path) -> str:
    """Return what the marker states; "" where there is none, or it is not to be seen from here."""
    try:
        return (out / NAME).read_text(encoding="utf-8")[:64]
    except (OSError, UnicodeDecodeError):
        return ""


def remove_marker(out: Path, text: str) -> None:
    """Remove the marker if it is still ours; takes that are being done elsewhere end by that."""
    with suppress(OSError):
        if marker_in(out) == text:
            (out / NAME).unlink()
