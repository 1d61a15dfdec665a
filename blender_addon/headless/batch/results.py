"""The takes of a batch as they end, and the summary's files, which are written while it goes on."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ..._exchange.outputs import atomic_outputs
from .engines.base import Engine
from .record import TakeRecord
from .summary import table, worst_first
from .summary_page import summary_page

SUMMARY = "summary"
_RARELY = 20.0
"""Writing may take one part of so many of the time."""
_LEAST_S = 2.0
"""Seconds from one writing of the results to the next, at the least; chosen by hand."""


class Results:
    """Collects records.

    Args:
        out: folder of the results.
    """

    def __init__(self, out: Path) -> None:
        self._out = out
        self._takes: dict[str, TakeRecord] = {}
        self._next, self._start = 0.0, time.monotonic()
        self._done = 0
        self._engine: Engine | None = None
        self._who = ""

    @property
    def outputs(self) -> list[str]:
        """The summary's files."""
        return [str(self._out / f"{SUMMARY}{suffix}") for suffix in (".json", ".txt", ".html")]

    @contextmanager
    def made_by(self, engine: Engine) -> Iterator[None]:
        """State on the page who works; also afterwards, when nobody can be asked any more."""
        self._engine = engine
        try:
            yield
        finally:
            self._who, self._engine = engine.headline(), None

    def add(self, record: TakeRecord, recalled: bool) -> None:
        """Keep the record of a take, and write the summary if that was not done just now."""
        self._takes[record["take"]] = record
        self._done += not recalled
        if time.monotonic() > self._next:
            self.write()

    def ordered(self) -> list[TakeRecord]:
        """Return the takes, worst first."""
        return worst_first(list(self._takes.values()))

    def write(self) -> None:
        """Write the summary, if there is a take to sum up.

        Raises:
            OutputNotWritable: the folder cannot be written to.
        """
        if not self._takes:
            return
        begun, ordered = time.monotonic(), self.ordered()
        texts = {
            f"{SUMMARY}.json": json.dumps(ordered, indent=1, ensure_ascii=False),
            f"{SUMMARY}.txt": table(ordered) + "\n",
            f"{SUMMARY}.html": summary_page(ordered, self._out, self._message()),
        }
        with atomic_outputs(self._out, tuple(texts), overwrite=True) as temporary:
            for name, text in texts.items():
                temporary[name].write_text(text, encoding="utf-8")
        took = time.monotonic() - begun
        self._next = time.monotonic() + max(_LEAST_S, _RARELY * took)

    def _message(self) -> str:
        minutes = (time.monotonic() - self._start) / 60
        rate = f"{self._done} done in {minutes:.1f} min" if self._done else "nothing was to be done"
        who = self._who if self._engine is None else self._engine.headline()
        return f"{rate} by {who}" if who else rate
