"""Record the inputs and the findings of each step of a take."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from solver_backend.exchange.diagnostics import Diagnostic, merge, sentence
from solver_backend.exchange.errors import FileDamaged
from solver_backend.exchange.outputs import write_text
from solver_backend.io.files import read_json

NAME = "steps.json"
_BEGUN = ""
"""Key of an unfinished output."""


class Records:
    """Inputs of one take's results, stored in the same folder."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / NAME
        self._keys: dict[str, str] = {}
        if self._path.is_file():
            with suppress(FileDamaged):
                kept = read_json(self._path)
                self._keys = {str(k): str(v) for k, v in kept.items()} if isinstance(kept, dict) else {}

    def is_made(self, output: Path, made_of: Any) -> bool:
        """Return whether an output exists and was made from these JSON values."""
        return output.is_file() and self._keys.get(output.name) == key_of(made_of)

    def is_ours(self, output: Path) -> bool:
        """Return whether this pipeline made an output, which it may then replace."""
        return output.name in self._keys

    @contextmanager
    def making(self, output: Path) -> Iterator[None]:
        """Mark an output as ours before it is written, so that the next run may replace an incomplete one."""
        self._keys[output.name] = _BEGUN
        self._write()
        try:
            yield
        except BaseException:
            if not output.exists():
                del self._keys[output.name]
                self._write()
            raise

    def made(self, output: Path, made_of: Any) -> None:
        """Record the inputs of an output."""
        self._keys[output.name] = key_of(made_of)
        self._write()

    def _write(self) -> None:
        write_text(self._path, json.dumps(self._keys, indent=2, sort_keys=True) + "\n", overwrite=True)


def key_of(values: Any) -> str:
    """Return a short hash of JSON values."""
    return hashlib.blake2b(json.dumps(values, sort_keys=True, default=str).encode(), digest_size=12).hexdigest()


ROAD_FILE = "road.json"
FORMAT, VERSION = "manifold_mocap_road", 2
"""Version 2 has ``diagnostics`` instead of the sentences of version 1."""


@dataclass(frozen=True)
class StepReport:
    """Report of one step."""

    step: str
    state: str
    diagnostics: tuple[Diagnostic, ...]
    """Notes and warnings."""
    pictures: tuple[str, ...] = ()

    @property
    def line(self) -> str:
        """The report in one line."""
        return f"{self.state}: {' '.join(map(sentence, self.diagnostics))}"

    def as_dict(self) -> dict[str, object]:
        """Return JSON values."""
        found = [item.as_dict() for item in self.diagnostics]
        return {"step": self.step, "state": self.state, "diagnostics": found, "pictures": list(self.pictures)}


class Steps:
    """Finished steps of one take, written to ``road.json`` after each step."""

    def __init__(self, folder: Path, take: str, order: tuple[str, ...]) -> None:
        self._folder, self._take, self._order = folder, take, order
        self._reports: dict[str, StepReport] = {}

    def report(self, step: str, state: str, found: Iterable[Diagnostic], pictures: Iterable[Path] = ()) -> None:
        """Add the report of a step, with the pictures that exist."""
        drawn = tuple(path.relative_to(self._folder).as_posix() for path in pictures if path.is_file())
        self._reports[step] = StepReport(step, state, tuple(found), drawn)
        values = {"format": FORMAT, "version": VERSION, "take": self._take, "steps": self.as_list()}
        write_text(self._folder / ROAD_FILE, json.dumps(values, indent=1, ensure_ascii=False) + "\n", overwrite=True)

    def in_order(self) -> list[StepReport]:
        """Return the reports in the order of the steps."""
        return [self._reports[step] for step in self._order if step in self._reports]

    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """Return all diagnostics, each once."""
        return merge(item for report in self.in_order() for item in report.diagnostics)

    def as_list(self) -> list[dict[str, object]]:
        """Return the steps in their order as JSON values."""
        return [report.as_dict() for report in self.in_order()]

    def lines(self) -> dict[str, str]:
        """Return a line of text per step."""
        return {report.step: report.line for report in self.in_order()}
