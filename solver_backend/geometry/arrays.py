"""One way to bring a constant into the caller's array world (NumPy or torch, type, device)."""

from __future__ import annotations

from typing import Any

import numpy as np
from array_api_compat import array_namespace

Array = Any
"""A NumPy array or a torch tensor."""


def constant(value: Any, like: Array) -> Array:
    """Return ``value`` as an array of the same kind, type and device as ``like``."""
    xp = array_namespace(like)
    device = getattr(like, "device", None)
    return xp.asarray(value, dtype=like.dtype, device=device if device != "cpu" else None)


def index(values: np.ndarray, like: Array) -> Array:
    """Return whole numbers that pick entries of arrays on the device of ``like``."""
    device = getattr(like, "device", None)
    return array_namespace(like).asarray(values, device=device if device != "cpu" else None)


def unset(shape: tuple[int, ...], like: Array) -> Array:
    """Return a large array to be filled, of the kind, type and device of ``like``.

    On the CPU NumPy allocates it, in huge pages; to write to torch's small pages first takes five times as long.
    """
    xp, device = array_namespace(like), getattr(like, "device", "cpu")
    if str(device) != "cpu":
        return xp.empty(shape, dtype=like.dtype, device=device)
    return xp.asarray(np.empty(shape, dtype=str(like.dtype).removeprefix("torch.")))


def to_numpy(value: Any) -> np.ndarray:
    """Return a float64 NumPy copy of an array of either kind, on any device."""
    return np.array(value.detach().cpu() if hasattr(value, "cpu") else value, dtype=np.float64)
