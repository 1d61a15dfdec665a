"""Numbers of things in words."""

from __future__ import annotations


def counted(count: int, thing: str) -> str:
    """Return a number with its noun, in the plural unless it is one: 1 camera, 4 cameras, 0 frames."""
    return f"{count} {thing}" if count == 1 else f"{count} {thing}s"
