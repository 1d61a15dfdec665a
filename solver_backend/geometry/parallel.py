"""Blocks of frames on all cores: NumPy's products let go of Python's lock, torch has threads of its own."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

from array_api_compat import is_numpy_array

Item = TypeVar("Item")
Result = TypeVar("Result")

MAX_THREADS = 8
"""More share one memory bus and gain nothing."""


def map_blocks(function: Callable[[Item], Result], blocks: Sequence[Item], like: Any) -> list[Result]:
    """Return ``[function(block) for block in blocks]``, in this order, with NumPy on several threads.

    Args:
        function: called once for each block; must not write to what another block reads.
        blocks: what to map.
        like: an array of the kind that the function works on.
    """
    threads = min(MAX_THREADS, len(blocks), os.cpu_count() or 1)
    if threads < 2 or not is_numpy_array(like):
        return [function(block) for block in blocks]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(function, blocks))
