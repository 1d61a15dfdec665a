"""What a process that solves does with freed memory: pages are used again within a stage, and returned after it."""

from __future__ import annotations

import platform
import subprocess
import sys

import pytest

_ARRAYS = """
import resource
import numpy as np
from solver_backend.fitters.freed_memory import give_back_freed_memory, keep_freed_memory

def resident_mb():
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * resource.getpagesize() / 2**20

def faults():
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt

{first}
np.ones(2**21)
before = faults()
for _ in range(20):
    np.ones(2**21)
made, kept = faults() - before, resident_mb()
give_back_freed_memory()
print(made, kept - resident_mb())
"""


def _made(first: str) -> tuple[int, float]:
    """Return how many pages 20 arrays of 16 MB took of the system, and how many MB were given back after them."""
    done = subprocess.run(
        [sys.executable, "-c", _ARRAYS.format(first=first)], capture_output=True, text=True, check=True
    )
    made, returned = done.stdout.split()
    return int(made), float(returned)


@pytest.mark.slow
@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="the allocator is not glibc's")
def test_freed_pages_are_used_again_and_given_back() -> None:
    plain, _ = _made("import ctypes; ctypes.CDLL(None).mallopt(-3, 2**17)")
    kept, returned = _made("keep_freed_memory()")
    assert kept < 0.2 * plain and returned > 10.0
