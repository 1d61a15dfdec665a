"""Results of this command line's verbs."""

from __future__ import annotations

from typing import Any, NotRequired, TypedDict

from .._exchange.errors import MocapError


class CommandResult(TypedDict):
    """The ``result`` event. A verb may add keys for programs."""

    event: NotRequired[str]
    outputs: list[str]  # Files that were written.
    notes: list[str]  # Sentences for people.
    exit_code: NotRequired[int]
    table: NotRequired[str]
    joints_deviation_mm: NotRequired[float]  # Largest distance between Blender's joints and the motion's.
    skin_deviation_mm: NotRequired[float]  # Largest distance between Blender's skin and the motion's.
    hands_and_feet_deviation_mm: NotRequired[float]
    scale: NotRequired[float]  # Of a character relative to the person.
    map: NotRequired[str]  # The character's bones by the roles of ours.


class TimedResult(CommandResult):
    """Of a verb that goes through frames."""

    frames: int
    fps: float
    seconds: NotRequired[float]


def failure(kind: str, name: str, error: MocapError) -> dict[str, Any]:
    """Return the record of a clip or target (the kind) that was left out."""
    return {kind: name, "code": error.code, "message": str(error), "exit_code": error.exit_code}


def failure_notes(kind: str, failed: list[dict[str, Any]]) -> list[str]:
    """Return a sentence about each clip or target that was left out."""
    return [f"{entry[kind]} failed: {entry['message']}" for entry in failed]
