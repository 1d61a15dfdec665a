"""The OpenBLAS kernels under which whatever is compared bit for bit runs: results must not hang on a processor's."""

from __future__ import annotations

import os
import platform
from pathlib import Path

import pytest

KERNELS = ("Haswell", "Zen", "SkylakeX")
_NEEDS = {"Haswell": "avx2", "Zen": "avx2", "SkylakeX": "avx512f"}


def environment_with_kernel(kernel: str) -> dict[str, str]:
    """Return a child's environment in which BLAS takes ``kernel``; skip where the processor cannot run it."""
    flags = Path("/proc/cpuinfo")
    if platform.machine() not in ("x86_64", "AMD64") or not flags.exists():
        pytest.skip(f"the kernel {kernel} can be chosen on x86-64 Linux alone")
    if _NEEDS[kernel] not in flags.read_text(encoding="utf-8").split():
        pytest.skip(f"this processor lacks {_NEEDS[kernel]}, which the kernel {kernel} needs")
    return {**os.environ, "OPENBLAS_CORETYPE": kernel, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
