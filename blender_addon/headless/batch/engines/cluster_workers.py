"""What is known about the workers of a cluster: which of them can do a batch's takes, and why others cannot."""

from __future__ import annotations

import time
from typing import Any

from ....errors import WorkersUnsuitable
from .base import Ticket
from .cluster_task import describe, versions, what_is_wrong

MEMORY = "memory_mb"
"""Resource of a worker, as ``dask worker --resources memory_mb=8000`` states it."""
_CLOCK_S = 60.0
"""Clocks that differ by more are reported."""
_FAILS = 3
"""A worker that fails to write so many takes in a row gets no more, while there are others."""


class Workers:
    """The workers of a scheduler, by their addresses.

    Args:
        address: of the scheduler, for errors.
        out: folder of the results.
        marker: what its marker states.
        patience_s: how long a batch waits for the first worker, or for another one.
    """

    def __init__(self, address: str, out: str, marker: str, patience_s: float) -> None:
        self._address, self._out, self._marker, self._patience_s = address, out, marker, patience_s
        self._fails: dict[str, int] = {}
        self._looked_at: set[str] = set()
        self._without: float | None = None
        self._notes: list[str] = []
        self.versions = versions()
        """What all workers must have."""
        self.bad: dict[str, str] = {}
        """Why a worker gets no takes."""
        self.client: Any = None
        """The connection."""

    @property
    def notes(self) -> list[str]:
        """What a person should know about them."""
        return [*self._notes, *(f"Worker {name} gets no takes: {why}." for name, why in self.bad.items())]

    @property
    def threads(self) -> int:
        """Threads of the workers that can do takes."""
        return sum(info["nthreads"] for address, info in self.infos().items() if address not in self.bad)

    @property
    def good(self) -> set[str]:
        """Those that can do takes."""
        return set(self.infos()) - set(self.bad)

    def note(self, text: str) -> None:
        """Keep a sentence, once."""
        if text not in self._notes:
            self._notes.append(text)

    def infos(self) -> dict[str, Any]:
        """Return what the scheduler reports about each worker; nothing while it is gone."""
        try:
            return dict(self.client.scheduler_info(n_workers=-1)["workers"])
        except Exception:  # the connection is going down; the next look reports it
            return {}

    def allowed(self, ticket: Ticket) -> set[str] | None:
        """Return the workers that may do a take, None for all."""
        good = self.good
        others = good - ticket.avoid
        if not self.bad and others == good:
            return None
        return others or good

    def state_memory(self, wanted_mb: float) -> bool:
        """Return whether all workers state how much memory their takes may have.

        Raises:
            WorkersUnsuitable: no worker has as much as a take may take.
        """
        stated = [info.get("resources", {}).get(MEMORY) for info in self.infos().values()]
        amounts = [amount for amount in stated if amount is not None]
        if amounts and max(amounts) < wanted_mb:
            raise WorkersUnsuitable(
                f"No worker has the {wanted_mb:g} MB that a take may take; the largest has {max(amounts):g} MB.",
                where=self._address, hint="Lower --take-memory, or start workers with more.",
            )  # fmt: skip
        return bool(amounts) and len(amounts) == len(stated)

    def wrote(self, worker: str, failure: str) -> None:
        """Remember that a worker could not write a take, or ("") that it could."""
        if not failure:
            self._fails.pop(worker, None)
            return
        fails = self._fails[worker] = self._fails.get(worker, 0) + 1
        self.note(f"Worker {worker} could not write: {failure}")
        if fails >= _FAILS and len(self.good) > 1:
            self.bad[worker] = f"it could not write {fails} takes in a row"

    def forget_looks(self) -> None:
        """Look at all of them again; another scheduler has other workers."""
        self._looked_at.clear()
        self._without = None

    def look_at_new(self) -> None:
        """Ask workers that have come about their versions, folders and clocks."""
        new = sorted(set(self.infos()) - self._looked_at)
        if not new:
            return
        try:
            asked = time.time()
            found = self.client.run(describe, self._out, workers=new, on_error="return")
        except Exception:  # a worker that has just died is looked at no more, the others the next time
            return
        self._looked_at.update(new)
        for worker, about in found.items():
            if isinstance(about, BaseException):
                if isinstance(about, ImportError):
                    self.bad[worker] = f"Manifold MoCap cannot be imported there ({about})"
                continue
            if wrong := what_is_wrong(about, self.versions, self._marker, self._out):
                self.bad[worker] = wrong
            ahead_s = about["time"] - asked
            if abs(ahead_s) > _CLOCK_S:
                self.note(
                    f"The clock of {about['host']} differs by {ahead_s:+.0f} s; nothing depends on it but the "
                    "times of files."
                )

    def require_some(self, patience_s: float | None = None) -> None:
        """Make sure that there has been a worker that can do takes not too long ago.

        Raises:
            WorkersUnsuitable: there was none; the first reasons are named.
        """
        if self.good:
            self._without = None
            return
        now = time.monotonic()
        self._without = self._without or now
        if now - self._without < (self._patience_s if patience_s is None else patience_s):
            return
        reasons = "; ".join(f"{worker}: {why}" for worker, why in list(self.bad.items())[:3])
        raise WorkersUnsuitable(
            f"No worker can do the takes: {reasons}." if reasons else "The scheduler has no workers.",
            where=self._address,
            hint="Workers need the same version, the same Python and the same folders as this program, under the same "
            "paths. Finished takes are kept." if reasons else "Start some: dask worker ADDRESS --nthreads 1.",
        )  # fmt: skip
