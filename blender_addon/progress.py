"""Progress of long work, told to a person or to a program by one JSON object a line."""

from __future__ import annotations

import json
import time
from typing import Any, Protocol, TextIO


class Progress(Protocol):
    """Receives how far a stage has come."""

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Report that ``done`` of ``total`` steps of ``stage`` are finished."""
        ...


def silent(stage: str, done: int, total: int) -> None:
    """Ignore progress."""


class StreamProgress:
    """Writes progress to a stream, as a bar for people or as JSON lines for programs.

    Args:
        stream: where to write.
        as_json: JSON lines (``{"event": "progress", "stage", "done", "total", "eta_s"}``) instead of a bar.
        interval_s: least time between two lines of one stage.
    """

    def __init__(self, stream: TextIO, *, as_json: bool, interval_s: float = 0.2) -> None:
        self._stream, self._as_json, self._interval_s = stream, as_json, interval_s
        self._stage, self._start, self._last = "", 0.0, 0.0

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Write how far a stage has come, unless it was said just now."""
        now = time.monotonic()
        if stage != self._stage:
            self._stage, self._start, self._last = stage, now, 0.0
        finished = done >= total
        if not finished and now - self._last < self._interval_s:
            return
        self._last = now
        eta_s = (now - self._start) * (total - done) / done if done > 0 else None
        if self._as_json:
            rounded = None if eta_s is None else round(eta_s, 2)
            self.event({"event": "progress", "stage": stage, "done": done, "total": total, "eta_s": rounded})
        else:
            self._draw(stage, done, total, eta_s)

    def event(self, event: dict[str, Any]) -> None:
        """Write one event as a JSON line."""
        self._stream.write(json.dumps(event) + "\n")
        self._stream.flush()

    def _draw(self, stage: str, done: int, total: int, eta_s: float | None) -> None:
        finished, terminal = done >= total, self._stream.isatty()
        if not (finished or terminal):
            return
        bar = "█" * int(24 * done / max(total, 1))
        left = "" if finished or eta_s is None else f"  {eta_s:4.0f} s left"
        start, end = "\r" if terminal else "", "\n" if finished else ""
        self._stream.write(f"{start}{stage:<28} {bar:<24} {done}/{total}{left}   {end}")
        self._stream.flush()
