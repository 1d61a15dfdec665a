"""What the verbs of this command line hand back."""

from __future__ import annotations

from typing import NotRequired, TypedDict


class CommandResult(TypedDict):
    """The ``result`` event; a verb may add keys for programs."""

    event: str
    outputs: list[str]
    """Files that were written."""
    notes: list[str]
    """Sentences for people."""
    exit_code: NotRequired[int]
    table: NotRequired[str]
    joints_deviation_mm: NotRequired[float]
    skin_deviation_mm: NotRequired[float]
    """Of what Blender shows from the motion, at most."""
    hands_and_feet_deviation_mm: NotRequired[float]
    scale: NotRequired[float]
    """Of a character by the person."""
    map: NotRequired[str]
    """Which bones of the character play which of ours."""


class TimedResult(CommandResult):
    """Of a verb that goes through frames."""

    frames: int
    fps: float
    seconds: NotRequired[float]
