"""Products of large matrices that are quick whatever library NumPy was built with."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from solver_backend.geometry.arrays import Array, array_namespace

_FAST = ("openblas", "mkl", "accelerate", "blis", "armpl")
"""Libraries that block their products by cache, as their names begin or end in NumPy's record of its build."""


def times_transposed(x: Array, weight: Array) -> Array:
    """Return the (N, m) ``x Wᵀ`` of (N, k) and (m, k).

    Blender as Linux distributions build it has the reference BLAS, and its own builds none: both reach 2.5 GFLOP/s here
    in single precision, where NumPy's ``einsum``, whose inner loop is a product along contiguous k, reaches 11.
    """
    if isinstance(x, np.ndarray) and not has_fast_blas():
        return np.einsum("nk,mk->nm", x, weight)
    return array_namespace(x).matmul(x, weight.T)


@cache
def has_fast_blas() -> bool:
    """Return whether NumPy was built with a fast library for products of matrices."""
    show: Any = np.show_config
    built = show(mode="dicts")
    name = str(built.get("Build Dependencies", {}).get("blas", {}).get("name", "")).lower()
    return any(library in name for library in _FAST)
