"""Process blocks of frames on all cores."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any, TypeVar

from solver_backend.exchange.errors import CommandLineInvalid
from solver_backend.geometry.arrays import array_namespace, is_torch

Item = TypeVar("Item")
Result = TypeVar("Result")

MAX_THREADS = 8  # More threads share a memory bus and gain nothing.
TORCH_BLOCK = 2  # Factor applied to block sizes with torch, which splits each operation between threads.


def map_blocks(
    function: Callable[[Item], Result], blocks: Sequence[Item], like: Any, done: Callable[[int], None] = lambda _: None
) -> list[Result]:
    """Return ``[function(block) for block in blocks]``, computed on several CPU threads.

    Args:
        function: called once per block. It must not write to data that another block reads.
        like: an array that the function uses. If it is a torch tensor, the blocks run one after the other, and torch
          uses the threads.
        done: called with the number of finished blocks. It may raise an error to stop.
    """
    threads = min(MAX_THREADS, usable_cores())
    if is_torch(like):
        with torch_threads(threads, like):
            return _collected(map(function, blocks), done)
    if min(threads, len(blocks)) < 2:
        return _collected(map(function, blocks), done)
    with ThreadPoolExecutor(min(threads, len(blocks))) as pool:
        return _collected(pool.map(function, blocks), done)


def _collected(results: Iterable[Result], done: Callable[[int], None]) -> list[Result]:
    found = list[Result]()
    for result in results:
        found.append(result)
        done(len(found))
    return found


def usable_cores() -> int:
    """Return the number of cores that this process may use, at most ``MANIFOLD_MOCAP_THREADS``.

    Batch jobs and containers limit the cores of a process. With more threads than cores, threads would evict each
    other's data from the cache.

    Raises:
        CommandLineInvalid: the environment variable is not a positive whole number.
    """
    affinity = getattr(os, "sched_getaffinity", None)  # only Linux reports it
    cores = len(affinity(0)) if affinity else os.cpu_count() or 1
    limit = os.environ.get("MANIFOLD_MOCAP_THREADS", "") or str(cores)
    if not limit.isdecimal() or int(limit) < 1:
        message = f"MANIFOLD_MOCAP_THREADS is {limit!r}, not a number of threads."
        raise CommandLineInvalid(message, where="environment", hint="Set it to a whole number such as 4, or unset it.")
    return min(cores, int(limit))


def block_size(size: int, like: Any) -> int:
    """Return the number of frames per block: ``size`` for NumPy arrays, ``TORCH_BLOCK`` times as many for tensors."""
    return size * TORCH_BLOCK if is_torch(like) else size


@contextmanager
def torch_threads(count: int, like: Any) -> Iterator[None]:
    """Limit torch to ``count`` threads inside the context. ``like`` is a tensor."""
    torch = array_namespace(like)
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)
