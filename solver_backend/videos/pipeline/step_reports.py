"""What the steps from videos found and drew, kept beside the results so that a window can show each once it is done."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from solver_backend.exchange.diagnostics import Diagnostic, merge, sentence
from solver_backend.exchange.outputs import write_text

NAME = "road.json"
FORMAT, VERSION = "manifold_mocap_road", 2
"""Version 1 held sentences, ``words`` and ``doubts``, where version 2 holds ``diagnostics``."""


@dataclass(frozen=True)
class StepReport:
    """What one step found."""

    step: str
    """Name of the step."""
    state: str
    """'made' now, or 'kept' from before."""
    diagnostics: tuple[Diagnostic, ...]
    """What it found: notes, and warnings where something is wrong or unsure."""
    pictures: tuple[str, ...] = ()
    """Pictures, as paths from the folder of the results."""

    @property
    def line(self) -> str:
        """All of it in one line."""
        return f"{self.state}: {' '.join(map(sentence, self.diagnostics))}"

    def as_dict(self) -> dict[str, object]:
        """Return plain JSON values."""
        return {
            "step": self.step, "state": self.state, "diagnostics": [item.as_dict() for item in self.diagnostics],
            "pictures": list(self.pictures),
        }  # fmt: skip


class Steps:
    """The steps of one take that are done, written to ``road.json`` after each."""

    def __init__(self, folder: Path, take: str, order: tuple[str, ...]) -> None:
        self._folder, self._take, self._order = folder, take, order
        self._reports: dict[str, StepReport] = {}

    def report(self, step: str, state: str, found: Iterable[Diagnostic], pictures: Iterable[Path] = ()) -> None:
        """Keep what a step found; of its pictures those that are there."""
        drawn = tuple(path.relative_to(self._folder).as_posix() for path in pictures if path.is_file())
        self._reports[step] = StepReport(step, state, tuple(found), drawn)
        values = {"format": FORMAT, "version": VERSION, "take": self._take, "steps": self.as_list()}
        write_text(self._folder / NAME, json.dumps(values, indent=1, ensure_ascii=False) + "\n", overwrite=True)

    def in_order(self) -> list[StepReport]:
        """Return the reports in the order of the steps."""
        return [self._reports[step] for step in self._order if step in self._reports]

    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """Return everything that was found, each once."""
        return merge(item for report in self.in_order() for item in report.diagnostics)

    def as_list(self) -> list[dict[str, object]]:
        """Return the steps in their order as plain JSON values."""
        return [report.as_dict() for report in self.in_order()]

    def lines(self) -> dict[str, str]:
        """Return a line of words for each step."""
        return {report.step: report.line for report in self.in_order()}
