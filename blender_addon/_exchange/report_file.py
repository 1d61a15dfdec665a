"""How a page of ours is distinguished from any other."""

from __future__ import annotations

from pathlib import Path

from .regular_file import open_regular

REPORT_MARK = '<meta name="generator" content="Manifold MoCap report">'
"""Stands in the head of every report."""
_HEAD_BYTES = 2000
"""Bytes of a page in which the mark stands; chosen by hand."""


def is_report(path: Path, folder: Path) -> bool:
    """Return whether a file is a page that a solve wrote into a folder: by its ending, its place and its head."""
    try:
        inside = path.resolve().parent == folder.resolve()
        if path.suffix.lower() != ".html" or not inside or not path.is_file():
            return False
        with open_regular(path) as stream:
            return REPORT_MARK.encode() in stream.read(_HEAD_BYTES)
    except OSError:
        return False
