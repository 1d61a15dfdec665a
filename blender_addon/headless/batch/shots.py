"""The shots of a data set as tasks of a batch's engines: filmed by the backend, coloured by Blender, each by itself."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

from ..._exchange.errors import MocapError
from ..._exchange.progress import Progress
from ..._exchange.version import VERSION
from ...errors import ShotsMissing
from ..child_verb import run_verb
from ..solver import run_solver
from .limits import TakeLimits

RECORDS, SHOTS = "tasks", "shots"
"""Folders of a data set: of the tasks' records, of the shots."""
FILM, COLOUR = "film", "colour"
_DONE = {FILM: "shot.json", COLOUR: "rgb.json"}
"""Files of a shot's folder that say that a step is whole."""


@dataclass(frozen=True)
class ShotsRequest:
    """The shots of a description, of a folder that the backend has claimed for it."""

    description: Path
    """JSON file."""
    data_set: Path
    """Folder of the data set."""
    names: tuple[str, ...]
    """Of the shots."""
    colour: bool = False
    """Colour pictures are asked for."""
    python: Path | None = None
    """Python to film with; None for this one."""
    limits: TakeLimits = field(default_factory=TakeLimits)
    counted: ClassVar[str] = "shots"

    @property
    def out(self) -> Path:
        """Folder of the records."""
        return self.data_set / RECORDS

    @property
    def items(self) -> list[Path]:
        """What the tasks are about: the folders of the shots, as they will be called."""
        return [self.data_set / SHOTS / name for name in self.names]

    def sees(self, item: Path) -> bool:
        """Return whether description and data set are to be seen from here; the shot is not there yet."""
        return self.description.is_file() and self.data_set.is_dir()

    def choices(self) -> dict[str, Any]:
        """Return what decides what is filmed: the description's bytes.

        Raises:
            OSError: it cannot be read.
        """
        return {"description": hashlib.sha256(self.description.read_bytes()).hexdigest()}

    def plain(self) -> dict[str, Any]:
        """Return the request for another process or machine: plain values, paths from the root."""
        return {
            "description": str(self.description.resolve()), "data_set": str(self.data_set.resolve()), "names": [],
            "out": str(self.out.resolve()), "colour": self.colour,
            "python": None if self.python is None else str(self.python),
        }  # fmt: skip

    @classmethod
    def from_plain(cls, values: dict[str, Any]) -> ShotsRequest:
        """Return the request that ``plain`` has written; a task knows its own shot alone."""
        python = Path(values["python"]) if values["python"] else None
        return cls(Path(values["description"]), Path(values["data_set"]), (), values["colour"], python)


class Shots:
    """The shots that are to be made, as a source of a batch."""

    closed = True

    def __init__(self, request: ShotsRequest) -> None:
        self._waiting = request.items

    def arrived(self) -> list[Path]:
        """Return the shots; nothing from the second call on."""
        found, self._waiting = self._waiting, []
        return found


def keys_of_shot(request: ShotsRequest, choices: dict[str, Any], item: Path) -> dict[str, str]:
    """Return the steps of a shot with their keys, of description, name and version."""
    steps = (FILM, COLOUR) if request.colour else (FILM,)
    return {
        step: hashlib.sha256(json.dumps([choices, item.name, step, VERSION]).encode()).hexdigest() for step in steps
    }


def do_step_of_shot(
    request: ShotsRequest, item: Path, step: str, progress: Progress, stopped: Callable[[], MocapError | None]
) -> dict[str, Any]:
    """Make a shot, or its colour pictures, in a process of its own; what is there stays.

    Raises:
        MocapError: it cannot be made, or was stopped.
    """
    given = [str(request.description), "--out", str(request.data_set)]
    if step == FILM:
        film = partial(run_solver, progress=progress, python=request.python, over_limit=lambda pid: stopped())
        film("studio", [*given, "--shot", item.name])
    else:
        run_verb("studio", [*given, "--colour-of", item.name], progress, stopped)
    return {"outputs": [f"../../{SHOTS}/{item.name}/{_DONE[step]}"], "notes": []}


def require_all(records: list[dict[str, Any]], request: ShotsRequest) -> None:
    """Make sure that all shots are there.

    Raises:
        ShotsMissing: some are not; the first are named with their reasons.
    """
    failed = [record for record in records if record["status"] not in ("done", "skipped")]
    if failed:
        told = "; ".join(f"{one['take']}: {one['error']['message']}" for one in failed[:3])
        raise ShotsMissing(
            f"{len(failed)} of {len(records)} shots could not be made: {told}", where=str(request.data_set),
            hint=f"The others are kept, what was tried stands in {RECORDS}; the same command does what is missing.",
        )  # fmt: skip
