"""One way to bring a constant into the caller's array world (NumPy or torch, type, device)."""

from __future__ import annotations

from typing import Any

from array_api_compat import array_namespace

Array = Any
"""A NumPy array or a torch tensor."""


def constant(value: Any, like: Array) -> Array:
    """Return ``value`` as an array of the same kind, type and device as ``like``."""
    xp = array_namespace(like)
    device = getattr(like, "device", None)
    return xp.asarray(value, dtype=like.dtype, device=device if device != "cpu" else None)
