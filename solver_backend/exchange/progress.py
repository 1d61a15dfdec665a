"""Write progress lines, the protocol between the solver and its caller."""

from __future__ import annotations

import json
import time
from collections import OrderedDict
from collections.abc import Mapping
from typing import Protocol, TextIO, runtime_checkable

from .json_file import as_plain
from .plain_text import plain


@runtime_checkable
class Progress(Protocol):
    """Callback for progress. A stage may call it any number of times."""

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Report the finished steps of a stage."""


def silent(stage: str, done: int, total: int) -> None:
    """Progress callback that does nothing."""


def prefixed(progress: Progress, prefix: str) -> Progress:
    """Wrap a progress callback so that stage names get a prefix."""

    def receive(stage: str, done: int, total: int) -> None:
        progress(prefix + stage, done, total)

    return receive


_STAGES = 16  # Largest number of stored stage starts. A batch's stage continues between the stages of its takes.


class _Clock:
    def __init__(self) -> None:
        self._stage = ""
        self._starts: OrderedDict[str, float] = OrderedDict()

    def starts(self, stage: str) -> bool:
        return stage != self._stage

    def eta_s(self, stage: str, done: int, total: int) -> float | None:
        """Return the remaining seconds of the stage, or None at its start."""
        now = time.monotonic()
        self._stage = stage
        start = self._starts.setdefault(stage, now)
        self._starts.move_to_end(stage)
        while len(self._starts) > _STAGES:
            self._starts.popitem(last=False)
        if done <= 0:
            self._starts[stage] = now
            return None
        return (now - start) * (total - done) / done


class _Paced:
    def __init__(self, stream: TextIO, interval_s: float = 0.1) -> None:
        self._stream, self._interval_s = stream, interval_s
        self._clock, self._last = _Clock(), 0.0

    def _is_early(self) -> bool:
        return time.monotonic() - self._last < self._interval_s


class ConsoleProgress(_Paced):
    """Progress display with one line per stage. On a terminal, this line is updated in place."""

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Draw the progress bar of the stage."""
        eta_s = self._clock.eta_s(stage, done, total)
        finished = done >= total
        if not finished and (not self._stream.isatty() or self._is_early()):
            return
        self._last = time.monotonic()
        bar = "█" * int(24 * done / max(total, 1))
        left = "" if finished or eta_s is None else f"  {eta_s:4.0f} s left"
        end = "\n" if finished else ""
        start = "\r" if self._stream.isatty() else ""
        self._stream.write(f"{start}{plain(stage):<28} {bar:<24} {done}/{total}{left}   {end}")
        self._stream.flush()


class JsonProgress(_Paced):
    """Writes progress as JSON lines at the start and end of each stage, and otherwise at most once per interval."""

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Write a progress event at the start and end of a stage, and otherwise at most once per interval."""
        first, eta_s = self._clock.starts(stage), self._clock.eta_s(stage, done, total)
        if not first and done < total and self._is_early():
            return
        self._last = time.monotonic()
        count = {"done": int(done), "total": int(total), "eta_s": None if eta_s is None else round(eta_s, 2)}
        self.event({"event": "progress", "stage": stage, **count})

    def event(self, event: Mapping[str, object]) -> None:
        """Write an event as a JSON line."""
        self._stream.write(json.dumps(as_plain(event), allow_nan=False) + "\n")
        self._stream.flush()
