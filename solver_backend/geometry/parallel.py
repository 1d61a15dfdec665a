"""Blocks of frames on all cores: NumPy's and torch's operations let go of Python's lock."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any, TypeVar

from array_api_compat import array_namespace, is_torch_array

Item = TypeVar("Item")
Result = TypeVar("Result")

MAX_THREADS = 8
"""More share one memory bus and gain nothing."""


def map_blocks(function: Callable[[Item], Result], blocks: Sequence[Item], like: Any) -> list[Result]:
    """Return ``[function(block) for block in blocks]``, in this order, on several threads of the CPU.

    Args:
        function: called once for each block; must not write to what another block reads.
        blocks: what to map.
        like: an array of the kind that the function works on.
    """
    threads = min(MAX_THREADS, len(blocks), os.cpu_count() or 1)
    if threads < 2 or str(getattr(like, "device", "cpu")) != "cpu":
        return [function(block) for block in blocks]
    with undivided(like), ThreadPoolExecutor(threads) as pool:
        return list(pool.map(function, blocks))


@contextmanager
def undivided(like: Any) -> Iterator[None]:
    """Keep torch from dividing each operation among threads: small ones would wait for one another.

    Args:
        like: an array of the kind that is worked with.
    """
    if not is_torch_array(like):
        yield
        return
    torch = array_namespace(like)
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
