"""What the road's steps said and drew, kept beside the results so that a window can show each as soon as it is done."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from solver_backend.exchange.outputs import write_text

NAME = "road.json"
FORMAT, VERSION = "manifold_mocap_road", 1


@dataclass(frozen=True)
class Told:
    """What one step said."""

    step: str
    """Name of the step."""
    state: str
    """'made' now, or 'kept' from before."""
    words: tuple[str, ...]
    """What it found, one sentence each."""
    doubts: tuple[str, ...] = ()
    """What is wrong or unsure, with what to do."""
    pictures: tuple[str, ...] = ()
    """Pictures, as paths from the folder of the results."""

    @property
    def line(self) -> str:
        """All of it in one line."""
        return "; ".join((f"{self.state}: {self.words[0]}", *self.words[1:], *self.doubts))

    def as_dict(self) -> dict[str, Any]:
        """Return plain JSON values."""
        return {
            "step": self.step, "state": self.state, "words": list(self.words), "doubts": list(self.doubts),
            "pictures": list(self.pictures),
        }  # fmt: skip


class Steps:
    """The steps of one take that are done, written to ``road.json`` after each."""

    def __init__(self, folder: Path, take: str, order: tuple[str, ...]) -> None:
        self._folder, self._take, self._order = folder, take, order
        self._told: dict[str, Told] = {}

    def tell(
        self, step: str, state: str, words: Iterable[str], doubts: Iterable[str] = (), pictures: Iterable[Path] = ()
    ) -> None:
        """Keep what a step said; of its pictures those that are there."""
        drawn = tuple(path.relative_to(self._folder).as_posix() for path in pictures if path.is_file())
        self._told[step] = Told(step, state, tuple(words), tuple(doubts), drawn)
        values = {"format": FORMAT, "version": VERSION, "take": self._take, "steps": self.as_list()}
        write_text(self._folder / NAME, json.dumps(values, indent=1, ensure_ascii=False) + "\n", overwrite=True)

    def as_list(self) -> list[dict[str, Any]]:
        """Return the steps in their order as plain JSON values."""
        return [self._told[step].as_dict() for step in self._order if step in self._told]

    def lines(self) -> dict[str, str]:
        """Return a line of words for each step."""
        return {step: self._told[step].line for step in self._order if step in self._told}
