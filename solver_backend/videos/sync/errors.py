"""Named errors of synchronisation."""

from __future__ import annotations

from solver_backend.exchange.errors import MocapError


class SyncUnknown(MocapError):
    """Nothing in the recording shows how the cameras' clocks differ."""

    code = "sync_unknown"
