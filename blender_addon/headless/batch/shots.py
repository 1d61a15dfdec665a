"""Process the shots of a data set with the engines of a batch."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

from ..._exchange.version import VERSION
from ...errors import ShotsMissing
from ..children import run_solver, run_verb
from .record import StepMade, TakeRecord
from .request import TakeLimits
from .work import Place, Plain, Step, from_plain, to_plain

RECORDS, SHOTS = "tasks", "shots"  # Folders in a data set for the records and for the shots.
FILM, COLOUR = "film", "colour"
_DONE = {FILM: "shot.json", COLOUR: "rgb.json"}
"""The file in a shot's folder that shows that a step is finished."""


@dataclass(frozen=True)
class Shots:
    """The shots of a data set. The solver has already created the data set's folder."""

    description: Path  # JSON file.
    data_set: Path  # Folder of the data set.
    digest: str  # SHA-256 of the description's bytes (see ``digest_of``).
    colour: bool = False  # Also render colour pictures.
    python: Path | None = None  # Python in which to film, or None for this one.
    limits: TakeLimits = field(default_factory=TakeLimits)
    kind: ClassVar = "shots"

    @property
    def out(self) -> Path:
        """Folder that contains the records."""
        return self.data_set / RECORDS

    def item(self, name: str) -> Path:
        """Return the output folder of a shot, given its name."""
        return self.data_set / SHOTS / name

    def sees(self, item: Path) -> bool:
        """Return whether this machine can read the description and the data set."""
        return self.description.is_file() and self.data_set.is_dir()

    def steps(self, item: Path) -> tuple[Step, ...]:
        """Return the steps of a shot. Keys depend on the description, the shot's name and the program's version."""
        choices = {"description": self.digest}
        return tuple(
            Step(name, hashlib.sha256(json.dumps([choices, item.name, name, VERSION]).encode()).hexdigest())
            for name in ((FILM, COLOUR) if self.colour else (FILM,))
        )

    def do_step(self, item: Path, step: str, place: Place) -> StepMade:
        """Film a shot, or render its missing colour pictures, in a separate process."""
        given = [str(self.description), "--out", str(self.data_set)]
        if step == FILM:
            words = [*given, "--shot", item.name]
            run_solver("dataset make", words, place.progress, python=self.python, stopped=lambda pid: place.stopped())
        else:
            run_verb("dataset make", [*given, "--colour-of", item.name], place.progress, place.stopped)
        return {"outputs": [f"../../{SHOTS}/{item.name}/{_DONE[step]}"], "notes": []}

    def plain(self) -> Plain:
        """Return the work as plain values with absolute paths, for another machine."""
        return {"kind": self.kind, **to_plain(self)}

    @classmethod
    def from_plain(cls, values: Plain) -> Shots:
        """Recreate the shots' settings from the JSON values of ``plain``."""
        return from_plain(cls, values, limits=TakeLimits(**values["limits"]))


def digest_of(description: Path) -> str:
    """Return the SHA-256 digest of a data set's description file."""
    return hashlib.sha256(description.read_bytes()).hexdigest()


def require_all(records: list[TakeRecord], data_set: Path) -> None:
    """Raise ``ShotsMissing`` if a shot failed. The message contains the first three reasons."""
    failed = [record for record in records if record["status"] not in ("done", "skipped")]
    if failed:
        reasons = "; ".join(f"{one['take']}: {one['error']['message']}" for one in failed[:3] if "error" in one)
        message = f"{len(failed)} of {len(records)} shots failed: {reasons}"
        hint = "The other shots are complete. Run the command again to make the missing ones."
        raise ShotsMissing(message, where=str(data_set), hint=hint)
