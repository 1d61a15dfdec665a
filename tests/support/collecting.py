"""Workers that collect one after the other, where Python has compiled nothing yet."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows: they collect at once
    fcntl = None

IN_TURN = "MOCAP_COLLECT_IN_TURN"  # Set by ``supply.checks`` in a new environment.


@contextmanager
def in_turn() -> Iterator[None]:
    """Wait until no other worker collects, so that it finds compiled what the first one imported.

    Compiling is two thirds of the first collection, and side by side each worker would compile everything. The other
    core is busy meanwhile: the linters run.
    """
    if fcntl is None or not sys.pycache_prefix or not os.environ.get(IN_TURN):
        yield
        return
    folder = Path(sys.pycache_prefix)
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "collecting.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield
