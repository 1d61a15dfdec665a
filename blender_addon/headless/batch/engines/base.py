"""What a batch asks of whoever does its takes."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from ..record import TakeRecord

LOST, ENDED, DIED = "lost", "ended", "died"


@dataclass
class Ticket:
    """A take that is to be done."""

    capture: Path
    """File or folder."""
    name: str
    """Of the take."""
    tries: int = 0
    """How often it was begun and failed for a reason that may lie with the worker."""
    avoid: set[str] = field(default_factory=set)
    """Workers that have failed with it."""


@dataclass(frozen=True)
class Ended:
    """A take that somebody is through with."""

    ticket: Ticket
    how: str
    """ENDED: the record states how; DIED: it has ended its workers; LOST: nobody knows, it is to be begun again."""
    record: TakeRecord | None = None
    """Of the take, if it ended."""
    worker: str = ""
    """Who did it."""


class Engine(Protocol):
    """Does takes, several at a time perhaps. Whoever does one twice does no harm."""

    tries: int
    """How often a take is tried before it is set aside."""

    def free(self) -> int:
        """Return how many more takes it would begin now."""
        ...

    def begin(self, ticket: Ticket) -> None:
        """Begin a take."""
        ...

    def ended(self, timeout_s: float) -> list[Ended]:
        """Return the takes that have ended, after waiting for one so long at most.

        Raises:
            MocapError: no more takes can be done.
        """
        ...

    def notes(self) -> list[str]:
        """Return what a person should know about the workers."""
        ...

    def headline(self) -> str:
        """Return who works, in a few words."""
        ...

    def close(self) -> None:
        """End what is being done, and tidy up."""
        ...
