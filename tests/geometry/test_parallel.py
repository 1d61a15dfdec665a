"""Blocks come back in their order, whatever thread worked on them."""

import os
import threading
import time

import numpy as np
import pytest

from solver_backend.exchange.errors import CommandLineInvalid
from solver_backend.geometry import parallel
from solver_backend.geometry.parallel import map_blocks, usable_cores


@pytest.fixture(autouse=True)
def _several_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    """Map as a solver does; the other tests may have a core of their own each."""
    monkeypatch.setattr(parallel, "MAX_THREADS", 8)


def test_results_keep_the_order_of_the_blocks():
    def late(block: int) -> int:
        time.sleep(0.002 * (5 - block))
        return block * block

    assert map_blocks(late, range(5), np.zeros(1)) == [0, 1, 4, 9, 16]


def test_an_error_in_a_block_is_the_callers():
    with pytest.raises(ZeroDivisionError):
        map_blocks(lambda block: 1 / block, [1, 0], np.zeros(1))


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="processes are pinned on Linux alone")
def test_a_pinned_process_has_as_many_threads_as_cores():
    before = os.sched_getaffinity(0)
    try:
        os.sched_setaffinity(0, {min(before)})
        assert usable_cores() == 1
        assert set(map_blocks(lambda _: threading.get_ident(), range(4), np.zeros(1))) == {threading.get_ident()}
    finally:
        os.sched_setaffinity(0, before)
    assert usable_cores() == len(before)


def test_the_environment_limits_threads_on_every_system(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)  # as on Windows
    monkeypatch.setattr(os, "cpu_count", lambda: 8)
    for limit, cores in (("", 8), ("3", 3), ("64", 8)):
        monkeypatch.setenv("MANIFOLD_MOCAP_THREADS", limit)
        assert usable_cores() == cores
    for wrong in ("0", "many", "-2"):
        monkeypatch.setenv("MANIFOLD_MOCAP_THREADS", wrong)
        with pytest.raises(CommandLineInvalid, match="MANIFOLD_MOCAP_THREADS"):
            usable_cores()
