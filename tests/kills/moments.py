"""When a program is killed: after a share of its time, or as it changes what lies in its folder."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

_LOOK_S = 0.003
EARLY, WORKING, WRITING, ENDING = "early", "working", "writing", "ending"
SHARES = {EARLY: (0.0, 0.35), WORKING: (0.35, 0.9), ENDING: (0.9, 1.1)}
"""Of an operation's time, from which a moment is drawn; the last kills come when it has ended."""
_AFTER_WRITING_S = 0.03  # A kill while it writes comes so long after a change of the folder, at most.


@dataclass(frozen=True)
class Moment:
    """A moment of an operation."""

    kind: str  # ``early``, ``working``, ``writing`` or ``ending``.
    share: float = 0.0  # Of the operation's time.
    change: int = 0  # Number of the change of its folder after which it is killed; 0: by its time.
    delay_s: float = 0.0  # Seconds after that change.

    def __str__(self) -> str:
        """Return it as it stands in the list of kills."""
        return f"{self.kind}, change {self.change}" if self.change else f"{self.kind}, {100 * self.share:.0f} %"


def drawn(rng: np.random.Generator, number: int, changes: int) -> Moment:
    """Draw the moment of a kill; the kinds take turns.

    Args:
        rng: randomness.
        number: of the kill of this operation.
        changes: of the folder, in a run that was let end.
    """
    kind = (EARLY, WRITING, WORKING, WRITING, ENDING)[number % 5]
    if kind == WRITING and changes:
        return Moment(kind, change=int(rng.integers(1, changes + 1)), delay_s=float(rng.uniform(0, _AFTER_WRITING_S)))
    low, high = SHARES[WORKING if kind == WRITING else kind]
    return Moment(kind, share=float(rng.uniform(low, high)))


def follow(folder: Path, over: Callable[[], bool], moment: Moment | None = None, seconds: float = 0.0) -> int:
    """Wait until a program is over or its moment has come, and return how often its folder changed.

    Args:
        folder: in which it works.
        over: whether it has ended.
        moment: to wait for; its end where there is none.
        seconds: that the operation took when it was let end.
    """
    begin, seen, changes = time.monotonic(), _listing(folder), 0
    while not over():
        if moment is not None and not moment.change and time.monotonic() - begin >= moment.share * seconds:
            break
        if (now := _listing(folder)) != seen:
            seen, changes = now, changes + 1
            if moment is not None and changes == moment.change:
                time.sleep(moment.delay_s)
                break
        time.sleep(_LOOK_S)
    return changes


def _listing(folder: Path) -> frozenset[tuple[str, int]]:
    """Return every path of a folder with its inode, so that a file put in the place of another is a change."""
    found: set[tuple[str, int]] = set()
    open_ones = [folder]
    while open_ones:
        try:
            inner = list(open_ones.pop().iterdir())
        except OSError:  # it has been renamed meanwhile
            continue
        for path in inner:
            try:
                about = path.lstat()
            except OSError:
                continue
            found.add((str(path), about.st_ino))
            if path.is_dir() and path.name != "home":
                open_ones.append(path)
    return frozenset(found)
