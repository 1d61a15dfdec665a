"""What the solver reports of each of several people in a capture, and the panel lists."""

from __future__ import annotations

from typing import TypedDict


class PersonSummary(TypedDict):
    """One person, as ``--json`` has it."""

    name: str
    frames: int
    """How many frames two views agree on."""
    first: int | None
    """The first of them, from 0; None where there is none."""
    last: int | None
    """The last of them."""
    views: float
    """How many views see the person in them, on average."""
    seen_percent: list[float]
    """Of all frames, by view."""
