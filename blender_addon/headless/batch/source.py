"""Where the items of a batch come from: a list, or a folder that others go on filling."""

from __future__ import annotations

import time
from pathlib import Path

from ..._exchange.errors import MocapError
from .record import fingerprint
from .request import BatchRequest, captures_in
from .work import take_name


class Listed:
    """Items that are known from the start.

    Args:
        items: files or folders.
    """

    closed = True

    def __init__(self, items: list[Path]) -> None:
        self._waiting = items

    def arrived(self) -> list[Path]:
        """Return the items; nothing from the second call on."""
        found, self._waiting = self._waiting, []
        return found

    def notes(self) -> list[str]:
        """Return nothing: all items are done."""
        return []


class Watched:
    """The captures that arrive in a folder, each once it has not changed for a while, and again when it has.

    Two captures of one name are one take: the first of them is done, the other is reported.

    Args:
        request: the batch.
        settled_s: for how long names, sizes and times of its files must stay the same, by this machine's own clock.
        idle_s: how long to wait for more; None for ever.
        poll_s: how often the folder is looked at.
    """

    def __init__(
        self, request: BatchRequest, settled_s: float = 5.0, idle_s: float | None = None, poll_s: float = 1.0
    ) -> None:
        self._request = request
        self._settled_s, self._idle_s, self._poll_s = settled_s, idle_s, poll_s
        self._seen: dict[Path, tuple[str, float]] = {}
        self._given: dict[Path, str] = {}
        self._looked = -poll_s
        self._last = time.monotonic()
        self._doubled: dict[str, str] = {}

    @property
    def closed(self) -> bool:
        """Whether nothing has arrived, or been on its way, for as long as is waited."""
        return self._idle_s is not None and time.monotonic() - self._last > self._idle_s

    def arrived(self) -> list[Path]:
        """Return the captures that have arrived, or have changed since they did."""
        now = time.monotonic()
        if now - self._looked < self._poll_s:
            return []
        self._looked, found = now, []
        names = {take_name(path): path for path in self._given}
        for path in captures_in(self._request):
            state = self._state(path)
            if state is None or self._given.get(path) == state:
                continue
            if self._seen.get(path, ("", 0.0))[0] != state:
                self._seen[path] = state, now
            self._last = now
            if now - self._seen[path][1] < self._settled_s:
                continue
            other = names.setdefault(take_name(path), path)
            if other != path:
                self._doubled[str(path)] = f"{path.name} is not done: {other.name} is called the same."
                self._given[path] = state
                continue
            self._given[path] = state
            found.append(path)
        return found

    def notes(self) -> list[str]:
        """Return which captures are not done because another has their name."""
        return list(self._doubled.values())

    def _state(self, path: Path) -> str | None:
        try:
            return fingerprint(path, {})
        except (OSError, MocapError):
            return None
